// The schedule of a film: which samples each tile gets, and when it stops.
#include "server/jobs/films/film_tiles.h"

#include "engine/geometry/tile_order.h"

#include <doctest/doctest.h>

#include <set>
#include <vector>

using namespace raynest;
using namespace raynest::server;

namespace {

/// Adds `count` samples to each pixel of a tile: `spread` apart around 1.
void add(Film& film, FilmTiles& tiles, std::uint64_t tile, std::uint32_t count, float spread) {
    const Window at = tiles.window(tile);
    for (std::uint32_t y = at.y; y < at.y + at.height; ++y)
        for (std::uint32_t x = at.x; x < at.x + at.width; ++x) {
            std::vector<FilmSample> samples(count);
            for (std::uint32_t s = 0; s < count; ++s)
                samples[s].radiance =
                    Vec3(1 + ((tiles.taken(tile) + s) % 2 == 0 ? spread : -spread));
            film.add(std::uint64_t{y} * film.size().width + x, tiles.taken(tile), samples);
        }
    tiles.add(tile, count, film);
}

}  // namespace

TEST_CASE("tiles are windows, and consecutive in the tile order of pixels") {
    for (const ImageSize size : {ImageSize{1, 1}, ImageSize{64, 8}, ImageSize{130, 21},
                                 ImageSize{37, 9}, ImageSize{200, 64}}) {
        CAPTURE(size.width);
        const FilmTiles tiles(size, 1, 0);
        std::uint64_t next = 0;
        for (std::uint64_t tile = 0; tile < tiles.count(); ++tile) {
            CHECK(tiles.first_pixel(tile) == next);
            next += tiles.pixels(tile);
            const Window at = tiles.window(tile);
            std::set<std::uint64_t> places;
            for (std::uint64_t i = 0; i < tiles.pixels(tile); ++i) {
                const std::uint64_t pixel =
                    tile_order(tiles.first_pixel(tile) + i, size.width, size.height);
                places.insert(pixel);
                CHECK(pixel % size.width - at.x < at.width);
                CHECK(pixel / size.width - at.y < at.height);
            }
            CHECK(places.size() == tiles.pixels(tile));
        }
        CHECK(next == size.pixels());
    }
}

TEST_CASE("a tile stops at a multiple of 16 samples when its error is small, whatever the steps") {
    const ImageSize size{70, 8};
    for (const std::uint32_t step : {1U, 5U, 16U, 1000U}) {
        Film film(size);
        FilmTiles tiles(size, 1000, 0.1F);
        // A relative error of 0.5 / sqrt(n): below 0.1 from 25 samples on, so at the check of 32.
        while (const std::uint32_t next = tiles.next_samples(0, 1000, step))
            add(film, tiles, 0, next, 0.5F);
        CHECK(tiles.taken(0) == 32);
        CHECK(tiles.taken(1) == 0);
        CHECK(tiles.fewest() == 0);
        CHECK(tiles.most() == 32);
        // A tile that has stopped is settled.
        CHECK(tiles.settled() == tiles.pixels(0) * 1000);
        CHECK(tiles.noise() == 0);
        while (const std::uint32_t next = tiles.next_samples(1, 1000, step))
            add(film, tiles, 1, next, 0.001F);
        CHECK(tiles.taken(1) == 16);
        CHECK(tiles.noise() == doctest::Approx(0.5F / std::sqrt(32.0F)).epsilon(0.1).scale(0));
    }
    FilmTiles endless(size, 1000, 0);
    CHECK(endless.next_samples(0, 64, 1000) == 64);
}

TEST_CASE("a film that is read back goes on where it was, and one with odd counts is refused") {
    const ImageSize size{70, 8};
    Film film(size);
    FilmTiles tiles(size, 100, 0);
    add(film, tiles, 0, 24, 0.5F);
    add(film, tiles, 1, 8, 0.5F);
    FilmTiles restored(size, 100, 0);
    REQUIRE(restored.restore(film));
    CHECK(restored.taken(0) == 24);
    CHECK(restored.taken(1) == 8);
    CHECK(restored.next_samples(1, 100, 1000) == 92);
    film.words(FilmLayer::samples)[3] = 23;
    CHECK_FALSE(restored.restore(film));
    film.words(FilmLayer::dropped)[3] = 1;
    CHECK(restored.restore(film));
}

TEST_CASE("passes double up to 64 samples and end with those asked for") {
    CHECK(refinement_passes(1) == std::vector<std::uint32_t>{1});
    CHECK(refinement_passes(6) == std::vector<std::uint32_t>{1, 2, 4, 6});
    CHECK(refinement_passes(200) ==
          std::vector<std::uint32_t>{1, 2, 4, 8, 16, 32, 64, 128, 192, 200});
}
