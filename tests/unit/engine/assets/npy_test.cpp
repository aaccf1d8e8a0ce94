#include "engine/assets/import.h"
#include "tests/unit/engine/assets/samples.h"
#include "tests/unit/engine/builtin_packs.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <limits>

using namespace raynest;
using test::registry;

namespace {

/// A .npy of values that are laid out as `dtype` and `order` say.
template <class T>
test::Bytes npy_of(const std::string& dtype, const std::string& shape, const std::vector<T>& values,
                   const std::string& order = "False") {
    std::string header =
        "{'descr': '" + dtype + "', 'fortran_order': " + order + ", 'shape': " + shape + ", }";
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

template <class T>
test::Bytes npy(const std::string& shape, const std::vector<T>& values) {
    return npy_of(sizeof(T) == 8 ? "<f8" : "<f4", shape, values);
}

/// Numbers with their bytes in reverse.
template <class T>
std::vector<T> swapped(std::vector<T> values) {
    for (T& value : values) {
        auto bytes = std::bit_cast<std::array<std::byte, sizeof(T)>>(value);
        std::reverse(bytes.begin(), bytes.end());
        value = std::bit_cast<T>(bytes);
    }
    return values;
}

Result<std::shared_ptr<const Snapshot>> load(const test::Bytes& spheres,
                                             const test::Bytes* instances = nullptr) {
    test::Upload upload("points.npy", spheres);
    if (instances != nullptr) upload.add("instances.npy", *instances);
    ImportRequest request = upload.request();
    request.primitive = "sphere";
    return import_here(request, ImportLimits{}, registry());
}

std::string message_of(const test::Bytes& spheres) {
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

TEST_CASE("every layout that numpy.save leaves is read alike") {
    const auto plain = load(npy<float>("(2, 4)", {0, 0, 0, 1, -5, 0, 0, 2}));
    REQUIRE(plain.has_value());
    const std::vector<std::int64_t> wide{0, 0, 0, 1, -5, 0, 0, 2};
    const std::vector<std::int16_t> narrow{0, 0, 0, 1, -5, 0, 0, 2};
    const std::vector<std::uint16_t> half{0, 0, 0, 0x3C00, 0xC500, 0, 0, 0x4000};
    for (const auto& file :
         {npy_of("<i8", "(2, 4)", wide), npy_of(">i8", "(2, 4)", swapped(wide)),
          npy_of("<i2", "(2, 4)", narrow), npy_of(">i2", "(2, 4)", swapped(narrow)),
          npy_of<std::int8_t>("|i1", "(2, 4)", {0, 0, 0, 1, -5, 0, 0, 2}),
          npy_of("<f2", "(2, 4)", half), npy_of(">f2", "(2, 4)", swapped(half)),
          npy_of<float>("<f4", "(2, 4)", {0, -5, 0, 0, 0, 0, 1, 2}, "True"),
          npy_of(">f8", "(2, 4)", swapped<double>({0, -5, 0, 0, 0, 0, 1, 2}), "True")}) {
        const auto scene = load(file);
        REQUIRE(scene.has_value());
        CHECK((*scene)->digest() == (*plain)->digest());
    }
    const auto unsigned_ones = load(npy_of<std::uint8_t>("|u1", "(1, 4)", {200, 0, 0, 1}));
    REQUIRE(unsigned_ones.has_value());
    CHECK((*unsigned_ones)->bounds().upper.x == doctest::Approx(201));
    CHECK(message_of(npy_of<std::uint16_t>("<f2", "(1, 4)", {0x7C00, 0, 0, 0x7E00}))
              .find("2 values") != std::string::npos);
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
    // The same placements with their first index running fastest.
    std::vector<float> columns;
    for (std::size_t i = 0; i < 4; ++i)
        for (std::size_t row = 0; row < 3; ++row)
            for (std::size_t k = 0; k < 2; ++k) columns.push_back(matrices[12 * k + 4 * row + i]);
    const auto fortran = npy_of("<f4", "(2, 3, 4)", columns, "True");
    const auto placed = load(spheres, &fortran);
    REQUIRE(placed.has_value());
    CHECK((*placed)->bounds().lower.x == doctest::Approx(-11));
    CHECK((*placed)->bounds().upper.x == doctest::Approx(11));
    const auto wrong = npy<float>("(4, 6)", matrices);
    CHECK_FALSE(load(spheres, &wrong).has_value());
}

TEST_CASE("an array of a wrong shape is an error that states the right one") {
    CHECK(message_of(npy<float>("(2, 3)", {0, 0, 0, 1, 1, 1})).find("(N, 4)") != std::string::npos);
    CHECK(message_of(npy_of<float>("<c8", "(1, 4)", {0, 0, 0, 1, 0, 0, 0, 0}))
              .find("real numbers of at most 64 bits") != std::string::npos);
    CHECK(message_of(npy<float>("(2, 4)", {0, 0, 0, 1})).find("cut short") != std::string::npos);
    CHECK(message_of(npy<float>("(4611686018427387904, 4)", {0}))
              .find("more bytes than a file has") != std::string::npos);
    const float nan = std::numeric_limits<float>::quiet_NaN();
    CHECK(message_of(npy<float>("(2, 4)", {0, 0, 0, 1, nan, nan, 0, 1})).find("2 values") !=
          std::string::npos);
    CHECK(message_of(npy<double>("(1, 4)", {1e300, 0, 0, 1})).find("1 values") !=
          std::string::npos);
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
