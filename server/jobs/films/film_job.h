// The job of a lit picture: samples that an integrator makes, added to a film, pass by pass.
//
//   receiving (files) ─► preparing ─► tracing a pass ─► encoding ─► sending ─► ended
//                                       ▲                              │ more passes
//                                       └──────────────────────────────┘
//
// A pass brings every tile to the same number of samples. A job that shows its progress, or that
// may have to end early, has many passes; others have one and finish tile after tile.
#pragma once

#include "server/jobs/films/film_options.h"
#include "server/jobs/films/film_tiles.h"
#include "server/jobs/picture_job.h"
#include "server/jobs/received_file.h"

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

class FilmJob final : public PictureJob {
public:
    /// `any` is the plan for occlusion rays; it has the backends of request.plan.
    FilmJob(const Services& services, const Caller& caller, PictureRequest request, Plan any,
            FilmOptions options);

    std::optional<Task> next() override;
    Reply<void> ended() override;
    [[nodiscard]] bool finished() const override;
    [[nodiscard]] bool needs_input() const override {
        return stage_ == Stage::receiving && (!resumed_.complete() || !environment_.complete());
    }
    std::uint64_t take_freed_input() override { return copies_.take_freed(); }
    Reply<std::uint64_t> feed(protocol::Frame frame) override;
    [[nodiscard]] std::optional<Progress> progress() const override;

    /// The most bulk bytes of the frame of a tile.
    static constexpr std::uint64_t tile_bytes =
        (4 * FilmTiles::pixels_max + protocol::alignment - 1) / protocol::alignment *
        protocol::alignment;

protected:
    [[nodiscard]] CastPlans plans() const override { return {&plan_, &any_}; }
    Reply<Payload> encode() override;
    void complete(wire::DoneT& done) const override;

private:
    enum class Stage { receiving, preparing, exposing, tracing, encoding, sending, finished };

    [[nodiscard]] std::uint64_t chunk_size(const Backend& backend,
                                           const Chunk& rest) const override;
    Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) override;
    void end_receiving();
    [[nodiscard]] Task film_task();
    /// Makes the film and the integrator, and reads the files that came with the request.
    Reply<void> make_film(const Stop& stop);
    void begin_pass();
    /// Measures the exposure of tiles that are sent before the end.
    [[nodiscard]] Task exposure_task();
    void trace_pass();
    /// Sums over all tiles for progress(), now and then. Any thread.
    void look_at_tiles(Clock::time_point now);
    /// Ends the stage of tracing or sending.
    void go_on();
    [[nodiscard]] bool is_last_pass() const { return pass_ + 1 == options_.passes.size(); }
    [[nodiscard]] bool overdue() const { return Clock::now() >= best_by_; }
    /// True if each tile is sent when it is finished.
    [[nodiscard]] bool streams_tiles() const;
    /// True if the film is encoded and sent after this pass, although it is not the last one.
    [[nodiscard]] bool shows_pass();
    [[nodiscard]] Reply<protocol::Frame> tile_frame(std::uint64_t tile) const;
    [[nodiscard]] std::vector<Attribute> all_attributes() const;

    /// Samples of `count` tiles from `tile` on, which are level.
    struct Run {
        std::uint64_t tile = 0;
        std::uint64_t count = 0;
        std::uint32_t samples = 0;
    };
    /// The tiles from `tile` to `end` that one call takes together; no samples: the tile is done.
    [[nodiscard]] Run run_at(std::uint64_t tile, std::uint64_t end, std::uint32_t target,
                             std::uint64_t samples_max) const;

    using WavefrontPointer = std::unique_ptr<Wavefront>;
    WavefrontPointer take_wavefront();
    void give_back(WavefrontPointer wavefront);

    const Plan any_;
    const FilmOptions options_;
    const Clock::time_point best_by_;
    const std::uint64_t tile_count_;
    std::optional<Film> film_;        ///< made by the task of stage preparing
    std::optional<FilmTiles> tiles_;  ///< likewise
    std::atomic<Clock::time_point> looked_{Clock::time_point::min()};
    std::atomic<std::uint32_t> fewest_{0};  ///< samples per pixel when the tiles were looked at
    std::atomic<float> noise_{0};           ///< estimated error then
    UploadCopies copies_;
    ReceivedFile resumed_;
    ReceivedFile environment_;
    std::string environment_hash_;
    std::unique_ptr<const Integrator> integrator_;
    float preview_stops_ = 0;  ///< exposure of tiles that are sent before the end

    Stage stage_;
    bool task_started_ = false;  ///< for the stages that have one task
    std::uint64_t chunks_running_ = 0;
    std::size_t pass_ = 0;
    bool final_ = false;         ///< the payload that is encoded or sent is the last one
    Clock::time_point began_{};  ///< when tracing began
    Clock::time_point shown_{};  ///< when a pass was last shown
    std::uint64_t settled_before_ = 0;

    std::mutex mutex_;
    std::vector<WavefrontPointer> idle_;
};

}  // namespace raynest::server
