// RENDER and HEATMAP: camera rays in chunks, then one payload, then pieces of it.
//
//   tracing (tasks in any order) ──all ended──► encoding (one task) ──► sending (pieces under
//   credit)
#pragma once

#include "engine/integrators/camera.h"
#include "engine/integrators/picture.h"
#include "server/execution/chunk_caster.h"
#include "server/execution/chunked_job.h"

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
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

/// The words of a picture request, checked.
struct PictureRequest {
    Plan plan;
    Camera camera;
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::uint32_t samples = 1;  ///< rays per pixel
    std::string encode;         ///< png | exr | raw
    Budget::Lease lease;        ///< of what the job holds, the finished payload included
    [[nodiscard]] std::uint64_t pixels() const { return std::uint64_t{width} * height; }
    [[nodiscard]] std::uint64_t rays() const { return pixels() * samples; }
};

/// Bytes of the frames that carry a payload of so many bytes at most: what its answer takes.
[[nodiscard]] std::uint64_t picture_answer_bytes(const Caller& caller, std::uint64_t payload_bytes);

/// What helps where a picture is too large, in words.
[[nodiscard]] std::string smaller_picture(std::string_view encode);

/// `bytes`: what the job holds; reserved from the budget. Asks for a camera of the scene and adds a
/// note where none was there.
Reply<PictureRequest> make_request(const Services& services, const Caller& caller, Plan plan,
                                   const wire::Camera* camera, std::uint32_t width,
                                   std::uint32_t height, std::string_view encode,
                                   std::uint64_t bytes);

class PictureJob : public ChunkedJob {
public:
    PictureJob(const Services& services, const Caller& caller, PictureRequest request);

    Frames greeting() override;
    std::optional<Task> next() override;
    Reply<void> ended() override;
    [[nodiscard]] bool finished() const override;
    [[nodiscard]] std::uint64_t held_bytes() const override { return request_.lease.bytes(); }
    Frames farewell() override;
    [[nodiscard]] std::optional<Progress> progress() const override;

protected:
    /// The plans by which pixels are traced.
    [[nodiscard]] virtual CastPlans plans() const = 0;
    /// Any thread: traces pixels, and keeps what the picture needs. Nothing where the caster has no
    /// answers.
    virtual std::optional<CameraHits> trace_pixels(const PixelRange& pixels,
                                                   const ColumnSource& scene, RayCaster& caster,
                                                   const PixelArrays& arrays) = 0;
    /// Any thread, after all chunks.
    virtual Reply<Payload> encode() = 0;
    /// Adds to DONE what only this kind of picture knows.
    virtual void complete(wire::DoneT& /*done*/) const {}

    /// A value for each pixel, on pages that come when workers write to them: zeroing a large
    /// picture would hold up the io thread, and all clients with it.
    template <class T>
    [[nodiscard]] std::unique_ptr<T[]> blank() const {
        return std::make_unique_for_overwrite<T[]>(request_.pixels());
    }
    /// Puts the values of a chunk where its pixels are. Chunks do not overlap.
    template <class T>
    void place(std::uint64_t first, std::span<const T> values, T* picture) const {
        for (std::size_t i = 0; i < values.size(); ++i) {
            picture[tile_order(first + i, request_.width, request_.height)] = values[i];
        }
    }

    [[nodiscard]] const PictureRequest& request() const { return request_; }

private:
    enum class Stage { tracing, encoding, sending };
    [[nodiscard]] std::uint64_t chunk_size(const Backend& backend,
                                           const Chunk& rest) const override;
    Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) override;
    /// A line for a user whose camera sees nothing, or only the backs of surfaces; else empty.
    [[nodiscard]] std::string hint() const;
    Task encode_task();
    Task send_task();

    const PictureRequest request_;
    const Sensor sensor_;
    const std::uint64_t piece_bytes_;
    std::atomic<std::uint64_t> backs_{0};  ///< hits on the back of a surface
    Stage stage_ = Stage::tracing;
    std::uint64_t chunks_running_ = 0;
    bool encode_started_ = false;
    bool piece_running_ = false;
    Payload payload_;  ///< written by the encoding task, read afterwards
    std::uint64_t sent_ = 0;
};

}  // namespace raynest::server
