#include "server/handlers/picture_job.h"

#include "engine/assets/image.h"
#include "engine/integrators/generators.h"
#include "server/handlers/ray_source.h"
#include "server/handlers/scene_info.h"

#include <algorithm>
#include <cstring>
#include <sstream>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint64_t piece_bytes_max = 1ULL << 20;

/// Header, control message and padding of a frame with a piece of the payload.
constexpr std::uint64_t piece_overhead_bytes = 512;

std::uint64_t piece_bytes(const Caller& caller) {
    return std::min(piece_bytes_max, caller.window_bytes / 2);
}

Reply<std::string> check_encode(std::string_view word) {
    if (word == "raw") return std::string(word);
    if (word != "png" && word != "exr")
        return refuse(Code::invalid_field,
                      "unknown encode '" + std::string(word) + "': use one of png, exr, raw");
    if (const auto images = images_available(); !images)
        return refuse(Code::unsupported, images.error().message + "; or ask for encode raw");
    return std::string(word);
}

}  // namespace

std::uint64_t picture_answer_bytes(const Caller& caller, std::uint64_t payload_bytes) {
    const std::uint64_t pieces = payload_bytes / (piece_bytes(caller) - protocol::alignment) + 1;
    return payload_bytes + pieces * piece_overhead_bytes;
}

Reply<PictureOrder> make_order(const Services& services, const Caller& caller, Plan plan,
                               const wire::Camera* camera, std::uint32_t width,
                               std::uint32_t height, std::string_view encode, std::uint64_t bytes) {
    PictureOrder order;
    auto word = check_encode(encode);
    if (!word) return tl::unexpected(word.error());
    order.encode = std::move(*word);

    auto chosen = choose_camera(plan.scene.snapshot(), camera_request(camera));
    // No camera of that name: a fault of the request, not of the scene.
    if (!chosen) return refuse(Code::invalid_field, chosen.error().message);
    order.camera = std::move(*chosen);
    const bool asked =
        camera != nullptr && (camera->look_at() || !protocol::text(camera->name()).empty());
    if (!asked && plan.scene.snapshot().view().camera_count == 0)
        plan.notes.push_back("the scene has no camera: this one frames its bounding box");

    order.plan = std::move(plan);
    order.width = width;
    order.height = height;
    services.peers.make_memory(bytes, caller.principal);
    auto lease = services.budget.reserve(bytes);
    if (!lease)
        return refuse(Code::resource_exhausted,
                      "a picture of " + std::to_string(width) + "x" + std::to_string(height) +
                          " takes " + std::to_string(bytes) + " bytes while it is made, " +
                          std::to_string(services.budget.limit() - services.budget.used()) +
                          " of raynestd's --memory are free; ask for a smaller `size`" +
                          (order.encode == "exr" ? ", or for PNG in place of EXR" : "") +
                          ", or start raynestd with more");
    order.lease = std::move(*lease);
    return order;
}

PictureJob::PictureJob(const Services& services, const Caller& caller, PictureOrder order)
    : services_(services),
      id_(caller.request_id),
      order_(std::move(order)),
      sensor_(camera_sensor(order_.camera, {}, {order_.width, order_.height})),
      chunk_rays_(order_.plan.chunk_rays_max(services.limits)),
      cuda_rays_(order_.plan.cuda_rays_max(services.limits)),
      piece_bytes_(piece_bytes(caller)),
      runs_{{0, order_.pixels()}} {}

Frames PictureJob::greeting() {
    wire::StartedT message = started(order_.plan, services_.limits);
    message.camera = clean_text(order_.camera.name, services_.limits.name_bytes_max);
    Frames frames;
    frames.push_back(*protocol::encode(id_, message));
    return frames;
}

std::optional<Task> PictureJob::next() {
    switch (stage_) {
        case Stage::tracing:
            if (Run run = take_run(); run.count != 0) return trace_task(std::move(run));
            return std::nullopt;
        case Stage::encoding:
            if (!encode_started_) return encode_task();
            return std::nullopt;
        case Stage::sending:
            // Pieces come in order: the next one is made when this one has been handed on.
            if (!piece_running_ && sent_ < payload_.bytes.size()) return send_task();
            return std::nullopt;
    }
    return std::nullopt;
}

Reply<void> PictureJob::ended() {
    if (stage_ == Stage::tracing && --chunks_running_ == 0 && tally_.rays() == order_.pixels())
        stage_ = Stage::encoding;
    else if (stage_ == Stage::encoding)
        stage_ = Stage::sending;
    else
        piece_running_ = false;
    return {};
}

bool PictureJob::finished() const {
    return stage_ == Stage::sending && sent_ == payload_.bytes.size();
}

Frames PictureJob::farewell() {
    wire::DoneT done = tally_.done(order_.plan);
    complete(done);
    if (std::string line = hint(); !line.empty()) done.notes.push_back(std::move(line));
    Frames frames;
    frames.push_back(*protocol::encode(id_, done));
    return frames;
}

std::string PictureJob::hint() const {
    const Snapshot& scene = order_.plan.scene.snapshot();
    if (scene.bounds().is_empty()) return {};
    const bool nothing = tally_.hits() == 0;
    // Every pixel, but for a few cracks and edges, is the back of something.
    const bool backs = order_.plan.query == query_closest && tally_.hits() == order_.pixels() &&
                       backs_ > order_.pixels() / 100 * 99;
    if (!nothing && !backs) return {};
    const Framing view = framing(scene.bounds());
    const WorldPoint& origin = scene.origin();
    std::ostringstream lookat;
    lookat.precision(origin == WorldPoint{} ? 6 : 12);
    for (const glm::dvec3& point : {view.eye, view.at}) {
        for (int i = 0; i < 3; ++i)
            lookat << (lookat.tellp() == 0 ? "" : ",")
                   << origin[static_cast<std::size_t>(i)] + point[i];
    }
    const std::string camera = "camera '" + order_.camera.name + "' ";
    return clean_text(
        camera +
            (nothing ? "sees nothing" : "sees only backs of surfaces, as from inside of them") +
            "; to frame the scene: raynest " + std::string(command()) + ' ' +
            order_.plan.scene.name + " --lookat " + lookat.str(),
        services_.limits.text_bytes_max);
}

std::optional<Progress> PictureJob::progress() const {
    if (stage_ == Stage::tracing) return Progress{tally_.rays(), order_.pixels(), "tracing"};
    if (stage_ == Stage::encoding) return Progress{0, 0, "encoding"};
    return Progress{sent_, payload_.bytes.size(), "sending"};
}

PictureJob::Run PictureJob::take_run() {
    const std::lock_guard lock(mutex_);
    if (runs_.empty()) return {};
    Run& rest = runs_.back();
    Run run = rest;
    run.count = std::min(on_cuda(rest) ? cuda_rays_ : chunk_rays_, rest.count);
    rest.first += run.count;
    rest.count -= run.count;
    if (rest.count == 0) runs_.pop_back();
    return run;
}

Task PictureJob::trace_task(Run run) {
    ++chunks_running_;
    Task task;
    task.lane = on_cuda(run) ? Lane::device : Lane::compute;
    task.run = [this, run = std::move(run)](const Stop& stop) { return trace_run(run, stop); };
    return task;
}

Reply<Frames> PictureJob::trace_run(const Run& run, const Stop& stop) {
    tally_.begin();
    TraceBuffers& buffers = TraceBuffers::of_this_thread();
    buffers.fallback = run.fallback;
    buffers.rays.resize(run.count);
    generate_tiles(sensor_, run.first, buffers.rays);
    if (const auto exposed = expose(run.first, buffers.rays, stop, buffers); !exposed) {
        if (!on_cuda(run) || buffers.fallback.empty()) return tl::unexpected(exposed.error());
        const std::lock_guard lock(mutex_);
        runs_.push_back({run.first, run.count, buffers.fallback});
        return Frames{};
    }
    const auto missed = std::count_if(buffers.hits.begin(), buffers.hits.end(),
                                      [](const HitRecord& hit) { return hit.hit == 0; });
    const auto misses = static_cast<std::uint64_t>(missed);
    backs_ += static_cast<std::uint64_t>(
        std::count_if(buffers.hits.begin(), buffers.hits.end(),
                      [](const HitRecord& hit) { return hit.hit != 0 && hit.front == 0; }));
    tally_.add(buffers, {run.count, run.count - misses, misses, 0});
    services_.metrics.rays += run.count;
    return Frames{};
}

Reply<void> PictureJob::trace_camera(std::uint64_t first, std::span<const Ray> rays,
                                     const Stop& stop, TraceBuffers& buffers) const {
    // A GPU makes the rays of a pinhole itself.
    const auto* const pinhole = std::get_if<Pinhole>(&sensor_);
    if (pinhole == nullptr || !order_.plan.on_cuda(buffers.fallback))
        return trace(order_.plan, rays, stop, buffers);
    const PinholeRays made{*pinhole, first, true};
    return trace(order_.plan, rays, stop, buffers, &made);
}

Task PictureJob::encode_task() {
    encode_started_ = true;
    Task task;
    task.run = [this](const Stop& stop) -> Reply<Frames> {
        // Once begun it takes its time, a second for a large PNG.
        if (stop.requested()) return refuse(Code::cancelled, "");
        auto payload = develop();
        if (!payload) return tl::unexpected(payload.error());
        payload_ = std::move(*payload);
        return Frames{};
    };
    return task;
}

Task PictureJob::send_task() {
    const std::uint64_t offset = sent_;
    const std::uint64_t count =
        std::min<std::uint64_t>(piece_bytes_ - protocol::alignment, payload_.bytes.size() - offset);
    sent_ += count;
    piece_running_ = true;
    Task task;
    task.reply_bytes_max = protocol::padded(count);
    task.run = [this, offset, count](const Stop&) -> Reply<Frames> {
        protocol::Bulk bulk;
        bulk.add("data", wire::Dtype::u8, 1, count);
        bulk.allocate();
        std::memcpy(bulk.block(0).data(), payload_.bytes.data() + offset, count);
        wire::PictureT message;
        message.width = payload_.width;
        message.height = payload_.height;
        message.encode = order_.encode;
        message.offset = offset;
        message.total = payload_.bytes.size();
        auto frame = protocol::encode(id_, std::move(message), std::move(bulk), services_.limits);
        if (!frame) return tl::unexpected(frame.error());
        Frames frames;
        frames.push_back(std::move(*frame));
        return frames;
    };
    return task;
}

}  // namespace raynest::server
