#include "server/jobs/films/film_tiles.h"

#include <algorithm>
#include <cmath>

namespace raynest::server {

FilmTiles::FilmTiles(ImageSize size, std::uint32_t samples, float noise)
    : size_(size),
      samples_(samples),
      noise_(noise),
      columns_(columns_of(size)),
      count_(count_of(size)),
      states_(std::make_unique<State[]>(count_)) {}

Window FilmTiles::window(std::uint64_t tile) const {
    Window window;
    window.x = static_cast<std::uint32_t>(tile % columns_) * columns;
    window.y = static_cast<std::uint32_t>(tile / columns_) * rows;
    window.width = std::min(columns, size_.width - window.x);
    window.height = std::min(rows, size_.height - window.y);
    return window;
}

std::uint64_t FilmTiles::first_pixel(std::uint64_t tile) const {
    const Window at = window(tile);
    // A band begins after all rows above it; within it, columns come before rows.
    return std::uint64_t{at.y} * size_.width + std::uint64_t{at.x} * at.height;
}

std::uint64_t FilmTiles::pixels(std::uint64_t tile) const {
    const Window at = window(tile);
    return std::uint64_t{at.width} * at.height;
}

std::uint32_t FilmTiles::next_samples(std::uint64_t tile, std::uint32_t target,
                                      std::uint32_t most) const {
    const State& state = states_[tile];
    const std::uint32_t taken = state.taken;
    if (state.stopped || taken >= target) return 0;
    std::uint32_t next = std::min(most, target - taken);
    if (noise_ > 0) next = std::min(next, check_every - taken % check_every);
    return next;
}

void FilmTiles::add(std::uint64_t tile, std::uint32_t samples, const Film& film) {
    measure(tile, samples, film);
}

void FilmTiles::measure(std::uint64_t tile, std::uint32_t samples, const Film& film) {
    State& state = states_[tile];
    const std::uint64_t settled_before = settled_of(tile);
    state.taken += samples;
    const Window at = window(tile);
    double squares = 0;
    double light = 0;
    for (std::uint32_t y = at.y; y < at.y + at.height; ++y) {
        for (std::uint32_t x = at.x; x < at.x + at.width; ++x) {
            const std::uint64_t pixel = std::uint64_t{y} * size_.width + x;
            const auto error = static_cast<double>(film.error(pixel));
            squares += error * error;
            light += static_cast<double>(std::abs(luminance(Vec3(film.colour(pixel)))));
        }
    }
    state.squares = static_cast<float>(squares);
    state.light = static_cast<float>(light);
    if (const std::uint32_t taken = state.taken;
        noise_ > 0 && taken != 0 && taken % check_every == 0) {
        // Root mean square of the errors against the mean luminance.
        const auto count = static_cast<double>(pixels(tile));
        state.stopped = std::sqrt(squares / count) <= static_cast<double>(noise_) * light / count;
    }
    settled_ += settled_of(tile) - settled_before;
}

std::uint64_t FilmTiles::settled_of(std::uint64_t tile) const {
    return pixels(tile) * (states_[tile].stopped ? samples_ : std::min(samples_, taken(tile)));
}

bool FilmTiles::restore(const Film& film) {
    for (std::uint64_t tile = 0; tile < count_; ++tile) {
        const Window at = window(tile);
        const std::uint32_t taken = film.taken(std::uint64_t{at.y} * size_.width + at.x);
        for (std::uint32_t y = at.y; y < at.y + at.height; ++y)
            for (std::uint32_t x = at.x; x < at.x + at.width; ++x)
                if (film.taken(std::uint64_t{y} * size_.width + x) != taken) return false;
        measure(tile, taken, film);
    }
    return true;
}

std::uint32_t FilmTiles::fewest() const {
    std::uint32_t fewest = ~0U;
    for (std::uint64_t tile = 0; tile < count_; ++tile) fewest = std::min(fewest, taken(tile));
    return fewest;
}

std::uint32_t FilmTiles::most() const {
    std::uint32_t most = 0;
    for (std::uint64_t tile = 0; tile < count_; ++tile) most = std::max(most, taken(tile));
    return most;
}

std::uint64_t FilmTiles::noisy() const {
    if (noise_ <= 0) return 0;
    std::uint64_t count = 0;
    for (std::uint64_t tile = 0; tile < count_; ++tile)
        if (!states_[tile].stopped && taken(tile) >= samples_) ++count;
    return count;
}

float FilmTiles::noise() const {
    double squares = 0;
    double light = 0;
    for (std::uint64_t tile = 0; tile < count_; ++tile) {
        if (taken(tile) < 2) return 0;
        squares += static_cast<double>(states_[tile].squares);
        light += static_cast<double>(states_[tile].light);
    }
    const auto count = static_cast<double>(size_.pixels());
    return light > 0 ? static_cast<float>(std::sqrt(squares / count) / (light / count)) : 0;
}

std::vector<std::uint32_t> refinement_passes(std::uint32_t samples) {
    constexpr std::uint32_t longest = 64;
    std::vector<std::uint32_t> passes;
    for (std::uint32_t next = 1; next < samples; next += std::min(next, longest))
        passes.push_back(next);
    passes.push_back(samples);
    return passes;
}

}  // namespace raynest::server
