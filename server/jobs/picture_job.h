// The base of RENDER and HEATMAP: traces camera rays, encodes one payload, sends it in pieces.
//
//   tracing (tasks in any order) ──all ended──► encoding (one task) ──► sending (under credit)
#pragma once

#include "engine/assets/images/image.h"
#include "engine/integrators/camera.h"
#include "engine/integrators/picture.h"
#include "server/execution/chunk_caster.h"
#include "server/jobs/chunked_job.h"
#include "server/jobs/payload_sender.h"

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

/// A checked picture request.
struct PictureRequest {
    Plan plan;
    Camera camera;
    std::uint32_t width = 0;  ///< the width of the pixels that are made
    std::uint32_t height = 0;
    std::uint32_t samples = 1;  ///< rays per pixel
    ImageSize whole = {};       ///< size of the picture that they are pixels of
    PixelWindow window = {};    ///< where they lie in it
    std::string request;        ///< for a tile: the same for all tiles of one picture
    std::string encode;         ///< png | exr | raw
    Budget::Lease lease;        ///< for all memory of the job, including the payload
    [[nodiscard]] std::uint64_t pixels() const { return std::uint64_t{width} * height; }
    [[nodiscard]] std::uint64_t rays() const { return pixels() * samples; }
};

/// True for the words of `encode` whose files the image module writes.
[[nodiscard]] inline bool is_image(std::string_view word) {
    return word == "png" || word == "exr";
}

/// The base of picture jobs.
class PictureJob : public ChunkedJob {
public:
    PictureJob(const Services& services, const Caller& caller, PictureRequest request);

    Frames greeting() override;
    std::optional<Task> next() override;
    Reply<void> ended() override;
    [[nodiscard]] bool finished() const override;
    [[nodiscard]] std::uint64_t held_bytes() const override {
        return ChunkedJob::held_bytes() + request_.lease.bytes();
    }
    Frames farewell() override;
    [[nodiscard]] std::optional<Progress> progress() const override;

protected:
    /// The word of the file that the job writes; others than png and exr are none.
    [[nodiscard]] virtual const std::string& file_word() const { return request_.encode; }
    [[nodiscard]] bool needs_preparation() const override {
        return ChunkedJob::needs_preparation() || is_image(file_word());
    }
    /// Loads the image module, too, which takes a second the first time.
    Reply<void> make_ready(const Stop& stop) override;
    [[nodiscard]] std::uint64_t chunk_size(const Backend& backend,
                                           const Chunk& rest) const override;
    /// For a job that deals out its work itself, in `total` units of its own.
    PictureJob(const Services& services, const Caller& caller, PictureRequest request,
               std::uint64_t total);

    /// Returns the plans for the integrator's rays.
    [[nodiscard]] virtual CastPlans plans() const = 0;
    /// Traces pixels and stores their values. Returns nothing if the caster failed. Any thread.
    virtual std::optional<CameraHits> trace_pixels(const PixelRange& /*pixels*/,
                                                   const ColumnSource& /*scene*/,
                                                   RayCaster& /*caster*/,
                                                   const PixelArrays& /*arrays*/) {
        return std::nullopt;
    }
    /// Traces the pixels of a chunk once more, by plans of its own, after trace_pixels(). Returns
    /// the number of rays. Any thread.
    virtual Traced<std::uint64_t> trace_again(const PixelRange& /*pixels*/, std::size_t /*backend*/,
                                              const Stop& /*stop*/, TraceBuffers& /*buffers*/) {
        return 0;
    }
    /// Returns room for the rays of some pixels, their hits, and their counters by these plans.
    [[nodiscard]] static PixelArrays arrays_for(const PixelRange& pixels, const CastPlans& plans,
                                                TraceBuffers& buffers);
    /// Encodes the payload after all chunks are traced. Any thread.
    virtual Reply<Payload> encode() = 0;
    /// Returns what made the picture, for the header of its file. Equal requests give equal lines.
    [[nodiscard]] std::vector<Attribute> provenance() const;
    /// Adds the fields of DONE that are specific to this kind of picture. Any thread.
    virtual void complete(wire::DoneT& /*done*/) const {}

    /// Allocates the values of all pixels. The first task calls it.
    virtual void make_arrays() {}
    /// Allocates a value for each pixel, uninitialised.
    template <class T>
    [[nodiscard]] std::unique_ptr<T[]> blank() const {
        return std::make_unique_for_overwrite<T[]>(request_.pixels());
    }
    /// Copies a chunk's values to the places of its pixels. Thread-safe: chunks do not overlap.
    template <class T>
    void place(std::uint64_t first, std::span<const T> values, T* picture) const {
        for (std::size_t i = 0; i < values.size(); ++i) {
            picture[pixel_of(first + i)] = values[i];
        }
    }

    /// Returns the place in the picture of a pixel, given in tile order.
    [[nodiscard]] std::uint64_t pixel_of(std::uint64_t number) const {
        return tile_order(number, request_.width, request_.height);
    }

    [[nodiscard]] const PictureRequest& request() const { return request_; }
    [[nodiscard]] const Sensor& sensor() const { return sensor_; }
    [[nodiscard]] PayloadSender& payload() { return payload_; }
    [[nodiscard]] const PayloadSender& payload() const { return payload_; }
    /// Returns a task that encodes the payload and makes DONE, whose fields sum over the picture.
    Task encode_task();

private:
    enum class Stage { tracing, encoding, sending };
    Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) override;
    /// Returns a note for a user whose camera sees nothing or only backs of surfaces; else empty.
    /// `rays`: as many as were traced.
    [[nodiscard]] std::string hint(std::uint64_t rays) const;
    /// Returns why a camera that frames the scene may see nothing, by what was asked for.
    [[nodiscard]] std::string hides() const;

    const PictureRequest request_;
    const Sensor sensor_;
    std::atomic<std::uint64_t> backs_{0};  ///< hits on the back of a surface
    Stage stage_ = Stage::tracing;
    std::uint64_t chunks_running_ = 0;
    bool encode_started_ = false;
    std::once_flag arrays_made_;
    PayloadSender payload_;
    wire::DoneT done_;  ///< made with the payload
                        ///< set by the encoding task, sent afterwards
};

}  // namespace raynest::server
