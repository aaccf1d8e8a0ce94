// The tiles of a film and the samples that each has: what is still to be made, and in which order.
//
// A tile is 64 columns of 8 rows, consecutive in the tile order of pixels. It is the unit of
// scheduling, of streaming, and of the decision to stop. That decision is made after fixed numbers
// of samples and looks at the tile alone, so that no order of work can change it.
#pragma once

#include "engine/integrators/film.h"
#include "engine/integrators/tonemap.h"

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

namespace raynest::server {

class FilmTiles {
public:
    static constexpr std::uint32_t columns = 64;
    static constexpr std::uint32_t rows = 8;
    static constexpr std::uint32_t pixels_max = columns * rows;
    /// A tile may stop after each multiple of so many samples.
    static constexpr std::uint32_t check_every = 16;

    /// `noise`: the estimated relative error below which a tile stops; 0: none does.
    FilmTiles(ImageSize size, std::uint32_t samples, float noise);

    [[nodiscard]] std::uint64_t count() const { return count_; }
    /// Number of tiles of a film of this size.
    [[nodiscard]] static std::uint64_t count_of(ImageSize size) {
        return columns_of(size) * ((size.height + rows - 1) / rows);
    }
    [[nodiscard]] Window window(std::uint64_t tile) const;
    /// Place of the tile's first pixel in the tile order, and the number of its pixels.
    [[nodiscard]] std::uint64_t first_pixel(std::uint64_t tile) const;
    [[nodiscard]] std::uint64_t pixels(std::uint64_t tile) const;

    /// Samples that each pixel of a tile has. Any thread, as for the functions below.
    [[nodiscard]] std::uint32_t taken(std::uint64_t tile) const { return states_[tile].taken; }
    /// Samples that a tile gets next, at most `most`, on its way to `target`; 0: it has them, or
    /// its error is small enough.
    [[nodiscard]] std::uint32_t next_samples(std::uint64_t tile, std::uint32_t target,
                                             std::uint32_t most) const;
    /// Counts samples that were added to the film; may decide that the tile stops.
    void add(std::uint64_t tile, std::uint32_t samples, const Film& film);
    /// Takes the counts of a film that was read from a file. False: pixels of one tile differ.
    [[nodiscard]] bool restore(const Film& film);

    /// Fewest and most samples of a pixel; as noisy() and noise(), it looks at all tiles.
    [[nodiscard]] std::uint32_t fewest() const;
    [[nodiscard]] std::uint32_t most() const;
    /// Samples of all pixels that are made, or will not be because a tile has stopped.
    [[nodiscard]] std::uint64_t settled() const { return settled_; }
    [[nodiscard]] std::uint64_t total() const { return size_.pixels() * samples_; }
    /// Tiles that have all their samples while their error is above `noise`.
    [[nodiscard]] std::uint64_t noisy() const;
    /// Estimated relative error of the picture; 0 while it is unknown.
    [[nodiscard]] float noise() const;

private:
    struct State {
        std::atomic<std::uint32_t> taken{0};
        std::atomic<bool> stopped{false};
        std::atomic<float> squares{0};  ///< sum of the pixels' squared standard errors
        std::atomic<float> light{0};    ///< sum of their luminances
    };
    /// Counts samples of a tile; updates its sums, and whether it stops.
    void measure(std::uint64_t tile, std::uint32_t samples, const Film& film);
    [[nodiscard]] std::uint64_t settled_of(std::uint64_t tile) const;
    static std::uint64_t columns_of(ImageSize size) { return (size.width + columns - 1) / columns; }

    const ImageSize size_;
    const std::uint32_t samples_;
    const float noise_;
    const std::uint64_t columns_;  ///< tiles of a band of 8 rows
    const std::uint64_t count_;
    std::unique_ptr<State[]> states_;
    std::atomic<std::uint64_t> settled_{0};
};

/// The sample counts after which all tiles are level: 1, 2, 4, ... 64, then each 64th, up to
/// `samples`.
[[nodiscard]] std::vector<std::uint32_t> refinement_passes(std::uint32_t samples);

}  // namespace raynest::server
