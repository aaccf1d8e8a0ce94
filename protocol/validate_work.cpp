// Checks of the messages of work: queries, pictures, and their answers (validate.h).
#include "protocol/checks.h"
#include "protocol/validate.h"

#include <cstdint>
#include <string_view>

namespace raynest::protocol {
namespace {

using flatbuffers::String;

void check_job(Checks& checks, const wire::Job& job) {
    checks.named("scene", job.scene())
        .name("intersector", job.intersector())
        .settings("settings", job.settings(), checks.limits().name_bytes_max, "name_bytes_max")
        .name("traversal", job.traversal())
        .name("worker", job.worker())
        .name("priority", job.priority())
        .items("hidden_instances", job.hidden_instances())
        .items("hidden_objects", job.hidden_objects())
        .items("only_instances", job.only_instances())
        .items("only_objects", job.only_objects())
        .tables("tables", job.tables())
        .finite("time", job.time())
        .name("animation", job.animation())
        .texts("hidden_paths", job.hidden_paths())
        .texts("only_paths", job.only_paths())
        .aligned("hidden_path_ids", job.hidden_path_ids(), checks.limits().list_items_max,
                 "list_items_max")
        .aligned("only_path_ids", job.only_path_ids(), checks.limits().list_items_max,
                 "list_items_max");
}

void check_camera(Checks& checks, const wire::Camera& camera) {
    const float fov = camera.fov_degrees();
    checks.name("camera", camera.name())
        .finite("eye", camera.eye())
        .finite("at", camera.at())
        .finite("up", camera.up())
        .that(fov >= 0 && fov < 180, "fov_degrees", "must lie in [0, 180)")
        .that(!camera.look_at() || (camera.eye() != nullptr && camera.at() != nullptr), "camera",
              "look_at needs eye and at");
}

void check_picture(Checks& checks, std::uint64_t width, std::uint64_t height) {
    const Limits& limits = checks.limits();
    checks.at_least("width", width, 1)
        .at_least("height", height, 1)
        .at_most("width", width, limits.picture_side_max, "picture_side_max")
        .at_most("height", height, limits.picture_side_max, "picture_side_max")
        .at_most("width * height", width * height, limits.picture_pixels_max, "picture_pixels_max");
}

/// A tile lies within the picture, or there is none.
template <class Message>
void check_tile(Checks& checks, const Message& message) {
    const std::uint64_t width = message.tile_width(), height = message.tile_height();
    if ((width | height | message.tile_x() | message.tile_y()) == 0) return;
    checks.that(width != 0 && height != 0, "tile", "has no width or no height")
        .that(message.tile_x() + width <= message.width() &&
                  message.tile_y() + height <= message.height(),
              "tile", "reaches beyond the picture");
}

bool is_word(const String* word, std::string_view value) {
    return word != nullptr && word->string_view() == value;
}

/// The daemon's generators read what the settings say.
void check_generator(Checks& checks, const wire::Generator& generator) {
    checks.named("generator", generator.kind())
        .settings("settings", generator.settings(), checks.limits().control_bytes_max,
                  "control_bytes_max");
}

void check_heat(Checks& checks, const wire::HeatStatistics& heat) {
    checks.name("metric", heat.metric())
        .finite("mean", heat.mean())
        .finite("clipped", heat.clipped())
        .finite("range_low", heat.range_low())
        .finite("range_high", heat.range_high())
        .finite("below", heat.below())
        .name("count", heat.count());
}

}  // namespace

Result<void> validate(const wire::Query& message, const Limits& limits) {
    const bool all = is_word(message.kind(), "all");
    return Checks(limits)
        .that(message.job() != nullptr, "job", "is missing")
        .nested(message.job(), check_job)
        .name("kind", message.kind())
        .names("fields", message.fields())
        .names("hidden", message.hidden())
        .at_most("max_hits", message.max_hits(), all ? limits.all_hits_max : limits.hits_max,
                 all ? "all_hits_max" : "hits_max")
        .nested(message.generator(), check_generator)
        .name("reduce", message.reduce())
        .at_least("ray_count", message.ray_count(), message.generator() != nullptr ? 0 : 1)
        .at_most("ray_count", message.ray_count(), limits.rays_max, "rays_max")
        .at_most("part_first", message.part_first(), limits.rays_max, "rays_max")
        .at_most("part_count", message.part_count(), limits.rays_max, "rays_max")
        .that(message.generator() != nullptr || (message.part_first() | message.part_count()) == 0,
              "part", "is of a generator's rays: of rays that you send, send the part alone")
        .result();
}

Result<void> validate(const wire::QueryRays& message, const Limits& limits) {
    return Checks(limits)
        .at_most("first_ray", message.first_ray(), limits.rays_max, "rays_max")
        .result();
}

Result<void> validate(const wire::Render& message, const Limits& limits) {
    Checks checks(limits);
    checks.that(message.job() != nullptr, "job", "is missing")
        .nested(message.job(), check_job)
        .nested(message.camera(), check_camera)
        .name("integrator", message.integrator())
        .name("environment", message.environment())
        .name("tonemap", message.tonemap())
        .name("exposure", message.exposure())
        .at_least("samples", message.samples(), 1)
        .at_most("samples", message.samples(), limits.samples_max, "samples_max")
        .finite("sun_azimuth", static_cast<double>(message.sun_azimuth()))
        .finite("sun_elevation", static_cast<double>(message.sun_elevation()))
        .finite("environment_rotate", static_cast<double>(message.environment_rotate()))
        .finite("noise", static_cast<double>(message.noise()))
        .that(message.noise() >= 0, "noise", "must not be negative")
        .at_most("resume_bytes", message.resume_bytes(), limits.upload_bytes_max,
                 "upload_bytes_max")
        .at_most("environment_bytes", message.environment_bytes(), limits.upload_bytes_max,
                 "upload_bytes_max")
        .name("encode", message.encode());
    check_picture(checks, message.width(), message.height());
    check_tile(checks, message);
    return checks.result();
}

Result<void> validate(const wire::Heatmap& message, const Limits& limits) {
    Checks checks(limits);
    checks.that(message.job() != nullptr, "job", "is missing")
        .nested(message.job(), check_job)
        .nested(message.other(), check_job)
        .nested(message.camera(), check_camera)
        .name("metric", message.metric())
        .name("palette", message.palette())
        .name("scale", message.scale())
        .name("range", message.range())
        .name("count", message.count())
        .name("encode", message.encode());
    check_picture(checks, message.width(), message.height());
    check_tile(checks, message);
    return checks.result();
}

Result<void> validate(const wire::Explain& message, const Limits& limits) {
    Checks checks(limits);
    checks.that(message.job() != nullptr, "job", "is missing")
        .nested(message.job(), check_job)
        .nested(message.camera(), check_camera)
        .that((message.origin() == nullptr) == (message.direction() == nullptr), "origin",
              "and direction make a ray together")
        .at_most("steps", message.steps(), limits.explain_steps_max, "explain_steps_max");
    check_picture(checks, message.width(), message.height());
    return checks.result();
}

Result<void> validate(const wire::Blame& message, const Limits& limits) {
    Checks checks(limits);
    checks.that(message.job() != nullptr, "job", "is missing")
        .nested(message.job(), check_job)
        .nested(message.camera(), check_camera)
        .at_most("top", message.top(), limits.list_items_max, "list_items_max");
    check_picture(checks, message.width(), message.height());
    return checks.result();
}

Result<void> validate(const wire::Started& message, const Limits& limits) {
    return Checks(limits)
        .name("scene", message.scene())
        .name("hash", message.hash())
        .name("intersector", message.intersector())
        .name("target", message.target())
        .name("traversal", message.traversal())
        .name("worker", message.worker())
        .name("camera", message.camera())
        .texts("notes", message.notes())
        .names("hidden", message.hidden())
        .text("worker_reason", message.worker_reason())
        .finite("origin", message.origin_x())
        .finite("origin", message.origin_y())
        .finite("origin", message.origin_z())
        .result();
}

Result<void> validate(const wire::Chunk& message, const Limits& limits) {
    return Checks(limits)
        .at_most("first_ray", message.first_ray(), limits.rays_max, "rays_max")
        .at_most("count", message.count(), limits.chunk_rays_max, "chunk_rays_max")
        .result();
}

Result<void> validate(const wire::Progress& message, const Limits& limits) {
    return Checks(limits).name("stage", message.stage()).result();
}

Result<void> validate(const wire::Payload& message, const Limits& limits) {
    Checks checks(limits);
    checks.name("encode", message.encode());
    check_picture(checks, message.width(), message.height());
    return checks.result();
}

Result<void> validate(const wire::Done& message, const Limits& limits) {
    return Checks(limits)
        .finite("seconds", message.seconds())
        .finite("queued_seconds", message.queued_seconds())
        .name("traversal", message.traversal())
        .nested(message.heat(), check_heat)
        .name("worker", message.worker())
        .texts("notes", message.notes())
        .text("note_of_all", message.note_of_all())
        .name("target", message.target())
        .result();
}

}  // namespace raynest::protocol
