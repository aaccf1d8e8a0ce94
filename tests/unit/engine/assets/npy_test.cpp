#include "engine/assets/npy.h"

#include "tests/unit/engine/assets/samples.h"

#include <limits>

using namespace raynest;

namespace {

template <class T>
test::Bytes npy(const std::string& shape, const std::vector<T>& values,
                const std::string& order = "False") {
    std::string header = std::string("{'descr': '") + (sizeof(T) == 8 ? "<f8" : "<f4") +
                         "', 'fortran_order': " + order + ", 'shape': " + shape + ", }";
    while ((header.size() + 11) % 64 != 0) header += ' ';
    header += '\n';
    std::string file = "\x93NUMPY\x01";
    file += '\0';
    file += static_cast<char>(header.size() & 0xFF);
    file += static_cast<char>(header.size() >> 8);
    file += header;
    file.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
    return test::to_bytes(file);
}

const Registry& registry() {
    static const auto loaded = Registry::load({});
    REQUIRE(loaded.has_value());
    return **loaded;
}

Result<std::shared_ptr<const Snapshot>> load(const test::Bytes& spheres,
                                             const test::Bytes* instances = nullptr) {
    test::Upload upload("points.npy", spheres);
    if (instances != nullptr) upload.add("instances.npy", *instances);
    ImportRequest request = upload.request();
    request.primitive = "sphere";
    return import_here(request, ImportLimits{}, registry());
}

std::string refusal(const test::Bytes& spheres) {
    const auto scene = load(spheres);
    REQUIRE_FALSE(scene.has_value());
    return scene.error().message;
}

}  // namespace

TEST_CASE("a point cloud becomes spheres, from float32 and float64 alike") {
    const auto narrow = load(npy<float>("(2, 4)", {0, 0, 0, 1, 5, 0, 0, 2}));
    const auto wide = load(npy<double>("(2, 4)", {0, 0, 0, 1, 5, 0, 0, 2}));
    REQUIRE(narrow.has_value());
    REQUIRE(wide.has_value());
    CHECK((*narrow)->digest() == (*wide)->digest());
    CHECK((*narrow)->record_types() == std::vector<std::string>{"sphere"});
    CHECK((*narrow)->bounds().upper.x == doctest::Approx(7));
}

TEST_CASE("instances.npy places the points") {
    const auto spheres = npy<float>("(1, 4)", {0, 0, 0, 1});
    const std::vector<float> matrices{1, 0, 0, 10,  0, 1, 0, 0, 0, 0, 1, 0,
                                      1, 0, 0, -10, 0, 1, 0, 0, 0, 0, 1, 0};
    for (const char* shape : {"(2, 12)", "(2, 3, 4)"}) {
        const auto instances = npy<float>(shape, matrices);
        const auto scene = load(spheres, &instances);
        REQUIRE(scene.has_value());
        CHECK((*scene)->statistics().instances == 2);
        CHECK((*scene)->bounds().lower.x == doctest::Approx(-11));
    }
    const auto wrong = npy<float>("(4, 6)", matrices);
    CHECK_FALSE(load(spheres, &wrong).has_value());
}

TEST_CASE("an array of a wrong shape is an error that states the right one") {
    CHECK(refusal(npy<float>("(2, 3)", {0, 0, 0, 1, 1, 1})).find("(N, 4)") != std::string::npos);
    CHECK(refusal(npy<float>("(1, 4)", {0, 0, 0, 1}, "True")).find("C order") != std::string::npos);
    CHECK(refusal(npy<float>("(2, 4)", {0, 0, 0, 1})).find("cut short") != std::string::npos);
    CHECK(refusal(npy<float>("(4611686018427387904, 4)", {0})).find("more bytes than a file has") !=
          std::string::npos);
    const float nan = std::numeric_limits<float>::quiet_NaN();
    CHECK(refusal(npy<float>("(2, 4)", {0, 0, 0, 1, nan, nan, 0, 1})).find("2 values") !=
          std::string::npos);
    CHECK(refusal(npy<double>("(1, 4)", {1e300, 0, 0, 1})).find("1 values") != std::string::npos);
    test::Upload upload("points.npy", npy<float>("(1, 4)", {0, 0, 0, 1}));
    ImportRequest request = upload.request();
    request.primitive = "teapot";
    CHECK_FALSE(import_here(request, ImportLimits{}, registry()).has_value());
}

TEST_CASE("an array cut anywhere is an error") {
    const auto file = npy<float>("(2, 4)", {0, 0, 0, 1, 5, 0, 0, 2});
    for (std::size_t length = 0; length < file.size(); ++length) {
        CAPTURE(length);
        const test::Bytes cut(file.begin(), file.begin() + static_cast<std::ptrdiff_t>(length));
        CHECK_FALSE(load(cut).has_value());
    }
}
