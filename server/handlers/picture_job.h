// RENDER and HEATMAP: camera rays in chunks, then one payload, then pieces of it.
//
//   tracing (tasks in any order) ──all ended──► encoding (one task) ──► sending (pieces under
//   credit)
#pragma once

#include "engine/integrators/camera.h"
#include "engine/integrators/generators.h"
#include "server/handlers/tracing.h"

#include <atomic>
#include <cstdint>
#include <mutex>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

/// The finished payload: an encoded file or raw rows.
struct Payload {
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::vector<std::byte> bytes;
};

/// What a picture request asks for, checked.
struct PictureOrder {
    Plan plan;
    Camera camera;
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::string encode;   ///< png | exr | raw
    Budget::Lease lease;  ///< of what the job holds, the finished payload included
    [[nodiscard]] std::uint64_t pixels() const { return std::uint64_t{width} * height; }
};

/// Bytes of the frames that carry a payload of so many bytes at most: what its answer takes.
[[nodiscard]] std::uint64_t picture_answer_bytes(const Caller& caller, std::uint64_t payload_bytes);

/// `bytes`: what the job holds; reserved from the budget. Asks for a camera of the scene and adds a
/// note where none was there.
Reply<PictureOrder> make_order(const Services& services, const Caller& caller, Plan plan,
                               const wire::Camera* camera, std::uint32_t width,
                               std::uint32_t height, std::string_view encode, std::uint64_t bytes);

class PictureJob : public Job {
public:
    PictureJob(const Services& services, const Caller& caller, PictureOrder order);

    Frames greeting() override;
    std::optional<Task> next() override;
    Reply<void> ended() override;
    [[nodiscard]] bool finished() const override;
    [[nodiscard]] std::uint64_t held_bytes() const override { return order_.lease.bytes(); }
    Frames farewell() override;
    [[nodiscard]] std::optional<Progress> progress() const override;

protected:
    /// Worker thread: traces `rays`, those from place `first` of the tile order on
    /// (integrators/camera.h), and keeps what the picture needs.
    virtual Reply<void> expose(std::uint64_t first, std::span<Ray> rays, const Stop& stop,
                               TraceBuffers& buffers) = 0;
    /// Worker thread, after all chunks.
    virtual Reply<Payload> develop() = 0;
    /// Worker thread: traces camera rays of expose().
    Reply<void> trace_camera(std::uint64_t first, std::span<const Ray> rays, const Stop& stop,
                             TraceBuffers& buffers) const;
    /// The command line's word for such a picture.
    [[nodiscard]] virtual std::string_view command() const = 0;
    /// Adds to DONE what only this kind of picture knows.
    virtual void complete(wire::DoneT& /*done*/) const {}

    /// A value for each pixel, on pages that come when workers write to them: zeroing a large
    /// picture would hold up the io thread, and all clients with it.
    template <class T>
    [[nodiscard]] std::unique_ptr<T[]> blank() const {
        return std::make_unique_for_overwrite<T[]>(order_.pixels());
    }
    /// Puts the values of a chunk where its pixels are. Chunks do not overlap.
    template <class T>
    void place(std::uint64_t first, std::span<const T> values, T* picture) const {
        for (std::size_t i = 0; i < values.size(); ++i) {
            picture[tile_order(first + i, order_.width, order_.height)] = values[i];
        }
    }

    [[nodiscard]] const PictureOrder& order() const { return order_; }
    [[nodiscard]] const Registry& registry() const { return services_.registry; }

private:
    enum class Stage { tracing, encoding, sending };
    /// Rays of the tile order, and why they are the CPU's, after a GPU gave them up.
    struct Run {
        std::uint64_t first = 0;
        std::uint64_t count = 0;
        std::string fallback = {};
    };
    [[nodiscard]] bool on_cuda(const Run& run) const { return order_.plan.on_cuda(run.fallback); }
    /// A line for a user whose camera sees nothing, or only the backs of surfaces; else empty.
    [[nodiscard]] std::string hint() const;
    /// The first run that waits, or a part of it; of none the count is 0.
    Run take_run();
    Reply<Frames> trace_run(const Run& run, const Stop& stop);
    Task trace_task(Run run);
    Task encode_task();
    Task send_task();

    const Services& services_;
    const std::uint64_t id_;
    const PictureOrder order_;
    const Sensor sensor_;
    const std::uint64_t chunk_rays_;
    const std::uint64_t cuda_rays_;
    const std::uint64_t piece_bytes_;
    Tally tally_;
    std::atomic<std::uint64_t> backs_{0};  ///< hits on the back of a surface
    Stage stage_ = Stage::tracing;
    std::uint64_t chunks_running_ = 0;
    std::mutex mutex_;
    std::vector<Run> runs_;  ///< not traced and not under way; those that came last go first
    bool encode_started_ = false;
    bool piece_running_ = false;
    Payload payload_;  ///< written by the encoding task, read afterwards
    std::uint64_t sent_ = 0;
};

}  // namespace raynest::server
