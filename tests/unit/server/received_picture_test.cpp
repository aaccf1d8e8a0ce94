// Pictures that come with a request: decoded in the import child alone, and checked afterwards.
#include "server/jobs/films/received_picture.h"

#include "server/documents/film_file.h"
#include "server/requests/words/film_options.h"
#include "tests/sanitized.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <array>
#include <chrono>
#include <cstddef>
#include <limits>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

using test::SmallDaemon;

constexpr ImageSize size{5, 3};
constexpr std::uint32_t samples = 4;

/// A film with a few samples, its file and the attributes of that.
struct Made {
    Made() {
        std::vector<FilmSample> made(samples);
        for (std::uint32_t i = 0; i < samples; ++i)
            made[i].radiance = Vec3(0.25F + static_cast<float>(i));
        for (std::uint64_t pixel = 0; pixel < size.pixels(); ++pixel) film.add(pixel, 0, made);
    }
    [[nodiscard]] std::vector<std::byte> file() const {
        auto payload = encode_film(film, "exr", {}, attributes);
        REQUIRE(payload);
        return {payload->bytes.begin(), payload->bytes.end()};
    }
    Film film{size};
    const std::vector<Attribute> attributes = {{"raynest:seed", "7"}};
};

/// The message and code of a refusal.
struct Refusal {
    Code code;
    std::string message;
};
template <class T>
Refusal refusal_of(const Reply<T>& reply) {
    REQUIRE_FALSE(reply);
    return {reply.error().code, reply.error().message};
}

/// A daemon whose import process is another program.
struct Decoder {
    explicit Decoder(std::vector<std::string> child) {
        daemon.services.import_child = std::move(child);
        daemon.services.import_limits.time_max = std::chrono::seconds(1);
    }
    Reply<void> read(const Made& made) {
        return read_film(daemon.services, "me", made.file(), made.attributes, samples, stop, film);
    }
    SmallDaemon daemon{{}, test::imports_grow ? 1ULL << 28 : 1ULL << 26};
    StopFlag stop{Clock::time_point::max()};
    Film film{size};
};

bool contains(const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
}

TEST_CASE("a film comes back through the import child with every bit") {
    if (!images_available()) return;
    const Made made;
    Decoder decoder({RAYNEST_TEST_IMPORT_CHILD, "--import-child"});
    decoder.daemon.services.import_limits.time_max = std::chrono::seconds(60);
    const auto read = decoder.read(made);
    REQUIRE_MESSAGE(read, (read ? "" : read.error().message));
    for (std::size_t i = 0; i < film_layers; ++i) {
        const auto before = made.film.words(static_cast<FilmLayer>(i));
        const auto after = decoder.film.words(static_cast<FilmLayer>(i));
        CHECK(std::vector(before.begin(), before.end()) == std::vector(after.begin(), after.end()));
    }
}

// Were a picture decoded in this process, these would succeed.
TEST_CASE("without a working import child a good picture is not decoded") {
    if (!images_available()) return;
    const Made made;
    CHECK(refusal_of(Decoder({"false"}).read(made)).code == Code::internal);
    CHECK(refusal_of(Decoder({"/nonexistent/raynestd"}).read(made)).code ==
          Code::resource_exhausted);
    const Refusal crashed = refusal_of(Decoder({RAYNEST_TEST_IMPORT_CHILD, "--crash"}).read(made));
    CHECK(crashed.code == Code::invalid_field);
    CHECK(contains(crashed.message, "ended the import process"));
    const Refusal killed = refusal_of(Decoder({RAYNEST_TEST_IMPORT_CHILD, "--killed"}).read(made));
    CHECK(killed.code == Code::resource_exhausted);
    CHECK(contains(killed.message, "short of memory"));
    const Refusal late = refusal_of(Decoder({"sleep", "1000"}).read(made));
    CHECK(late.code == Code::invalid_field);
    CHECK(contains(late.message, "longer than 1 s"));
    Decoder stopped({"sleep", "1000"});
    stopped.stop.request();
    CHECK(refusal_of(stopped.read(made)).code == Code::cancelled);

    Decoder broken({"false"});
    const std::vector<float> plane(8, 1);
    const std::array channels{Channel{"R", plane, {}}, Channel{"G", plane, {}},
                              Channel{"B", plane, {}}};
    const auto file = encode_exr(4, 2, channels);
    REQUIRE(file);
    CHECK(refusal_of(read_environment(broken.daemon.services, "me", *file, broken.stop)).code ==
          Code::internal);
}

TEST_CASE("an import child that lacks memory is no fault of the file") {
    if (!images_available() || test::sanitized) return;
    Decoder decoder({RAYNEST_TEST_IMPORT_CHILD, "--import-child"});
    decoder.daemon.services.import_limits = {.bytes_max = 128ULL << 20};
    CHECK(refusal_of(decoder.read(Made{})).code == Code::resource_exhausted);
}

TEST_CASE("a film with values that no film has is refused") {
    Made made;
    CHECK(check_film(made.film, samples));
    CHECK(contains(refusal_of(check_film(made.film, samples - 1)).message,
                   "has 4 samples of a pixel: ask for more"));
    const auto refused_with = [&](FilmLayer layer, float value) {
        float& place = made.film.floats(layer)[7];
        const float before = std::exchange(place, value);
        const Refusal refusal = refusal_of(check_film(made.film, samples));
        place = before;
        CHECK(refusal.code == Code::invalid_field);
        return refusal.message;
    };
    constexpr float nan = std::numeric_limits<float>::quiet_NaN();
    constexpr float infinity = std::numeric_limits<float>::infinity();
    CHECK(contains(refused_with(FilmLayer::r, nan), "layer R of pixel 2,1 is not finite"));
    CHECK(contains(refused_with(FilmLayer::n_z, -infinity), "layer N.Z of pixel 2,1"));
    CHECK(contains(refused_with(FilmLayer::z, infinity), "layer Z of pixel 2,1"));
    CHECK(contains(refused_with(FilmLayer::variance, -1), "variance of pixel 2,1 is negative"));
    CHECK(check_film(made.film, samples));

    made.film.words(FilmLayer::dropped)[7] = 1;
    CHECK(contains(refusal_of(check_film(made.film, samples)).message, "has 5 samples"));
    // The sum does not wrap around.
    made.film.words(FilmLayer::dropped)[7] = ~0U;
    CHECK(contains(refusal_of(check_film(made.film, samples)).message, "more than 65536"));
}

}  // namespace
}  // namespace raynest::server
