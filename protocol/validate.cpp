#include "protocol/validate.h"

#include "protocol/checks.h"

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <utility>

namespace raynest::protocol {
namespace {

using flatbuffers::String;

void check_job(Checks& checks, const wire::Job& job) {
    checks.name("scene", job.scene())
        .needs("scene", job.scene())
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
        .name("animation", job.animation());
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
    checks.name("generator", generator.kind())
        .needs("generator", generator.kind())
        .settings("settings", generator.settings(), checks.limits().control_bytes_max,
                  "control_bytes_max");
}

void check_info(Checks& checks, const wire::SceneInfo& info) {
    checks.name("name", info.name())
        .name("hash", info.hash())
        .name("build", info.build())
        .name("intersector", info.intersector())
        .names("cameras", info.cameras())
        .names("skipped_reasons", info.skipped_reasons())
        .numbers("skipped", info.skipped_reasons(), info.skipped_counts())
        .texts("warnings", info.warnings())
        .names("record_types", info.record_types())
        .numbers("record_counts", info.record_types(), info.record_counts())
        .names("animations", info.animations())
        .numbers("animation_seconds", info.animations(), info.animation_seconds())
        .finite("origin", info.origin_x())
        .finite("origin", info.origin_y())
        .finite("origin", info.origin_z());
}

void check_param(Checks& checks, const wire::Param& param) {
    checks.name("param", param.name())
        .needs("param", param.name())
        .text("text", param.text())
        .name("type", param.type())
        .names("choices", param.choices());
}

void check_output(Checks& checks, const wire::Output& output) {
    checks.name("output", output.name())
        .needs("output", output.name())
        .text("text", output.text())
        .name("type", output.type());
}

void check_variant(Checks& checks, const wire::Variant& variant) {
    checks.name("variant", variant.name())
        .needs("variant", variant.name())
        .text("text", variant.text())
        .name("target", variant.target())
        .names("targets", variant.targets())
        .names("queries", variant.queries());
    if (variant.params() != nullptr)
        for (const wire::Param* param : *variant.params()) checks.nested(param, check_param);
    if (variant.outputs() != nullptr)
        for (const wire::Output* output : *variant.outputs()) checks.nested(output, check_output);
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

void check_job_info(Checks& checks, const wire::JobInfo& info) {
    checks.name("owner", info.owner())
        .name("kind", info.kind())
        .name("detail", info.detail())
        .name("scene", info.scene())
        .name("state", info.state())
        .name("stage", info.stage())
        .name("worker", info.worker())
        .text("error", info.error());
}

}  // namespace

Result<void> validate(const wire::Hello& message, const Limits& limits) {
    return Checks(limits)
        .name("client", message.client())
        .name("token", message.token())
        .that(message.version_min() <= message.version_max(), "version_min", "is above version_max")
        .at_most("window_bytes", message.window_bytes(), limits.window_bytes_max,
                 "window_bytes_max")
        .result();
}

Result<void> validate(const wire::Welcome& message, const Limits& limits) {
    return Checks(limits)
        .name("server", message.server())
        .name("principal", message.principal())
        .name("role", message.role())
        .result();
}

Result<void> validate(const wire::Error& message, const Limits& limits) {
    return Checks(limits).name("name", message.name()).text("message", message.message()).result();
}

Result<void> validate(const wire::Credit& message, const Limits& limits) {
    return Checks(limits)
        .at_least("bytes", message.bytes(), 1)
        .at_most("bytes", message.bytes(), limits.window_bytes_max, "window_bytes_max")
        .result();
}

Result<void> validate(const wire::Cancel& message, const Limits& limits) {
    return Checks(limits).text("reason", message.reason()).result();
}

Result<void> validate(const wire::Load& message, const Limits& limits) {
    Checks checks(limits);
    checks.text("source", message.source())
        .needs("source", message.source())
        .name("name", message.name())
        .name("build", message.build())
        .name("primitive", message.primitive())
        .texts("file_names", message.file_names())
        .digests("file_digests", message.file_names(), message.file_digests())
        .numbers("files", message.file_names(), message.file_bytes())
        .finite("origin", message.origin_x())
        .finite("origin", message.origin_y())
        .finite("origin", message.origin_z())
        .finite("unit", message.unit())
        .name("up", message.up())
        .finite("radius", message.radius())
        .finite("spacing", message.spacing())
        .texts("masks", message.masks())
        .names("share", message.share());
    const auto is_given = [](const auto* list) { return list != nullptr && list->size() != 0; };
    if (is_given(message.file_hashes()) || !is_given(message.file_digests()))
        checks.numbers("files", message.file_names(), message.file_hashes());
    if (message.file_names() != nullptr)
        checks.at_most("files", message.file_names()->size(), limits.upload_files_max,
                       "upload_files_max");
    if (checks.good() && message.file_bytes() != nullptr) {
        std::uint64_t sum = 0;  // stays below 2 * upload_bytes_max: cannot wrap
        for (const std::uint64_t bytes : *message.file_bytes()) {
            checks.at_most("file_bytes", bytes, limits.upload_bytes_max, "upload_bytes_max");
            if (bytes > limits.upload_bytes_max || sum > limits.upload_bytes_max) break;
            sum += bytes;
        }
        checks.at_most("file_bytes", sum, limits.upload_bytes_max, "upload_bytes_max");
    }
    return checks.result();
}

Result<void> validate(const wire::Need& message, const Limits& limits) {
    return Checks(limits).items("files", message.files()).result();
}

Result<void> validate(const wire::Upload& message, const Limits& limits) {
    return Checks(limits)
        .at_most("file", message.file(), limits.upload_files_max - 1, "upload_files_max - 1")
        .at_most("offset", message.offset(), limits.upload_bytes_max, "upload_bytes_max")
        .result();
}

Result<void> validate(const wire::SceneInfo& message, const Limits& limits) {
    Checks checks(limits);
    check_info(checks, message);
    return checks.result();
}

Result<void> validate(const wire::Loaded& message, const Limits& limits) {
    return Checks(limits)
        .that(message.info() != nullptr, "info", "is missing")
        .nested(message.info(), check_info)
        .finite("seconds", message.seconds())
        .result();
}

Result<void> validate(const wire::SceneList& message, const Limits& limits) {
    return Checks(limits)
        .texts("names", message.names())  // another's scene has its owner before its name
        .names("hashes", message.hashes())
        .equally_long("hashes", message.names(), message.hashes())
        .numbers("epochs", message.names(), message.epochs())
        .numbers("instanced_triangles", message.names(), message.instanced_triangles())
        .numbers("bytes", message.names(), message.bytes())
        .names("owners", message.owners())
        .equally_long("owners", message.names(), message.owners())
        .numbers("age_ms", message.names(), message.age_ms())
        .numbers("idle_ms", message.names(), message.idle_ms())
        .numbers("holders", message.names(), message.holders())
        .texts("shares", message.shares())
        .that(message.shares() == nullptr || message.names() == nullptr ||
                  message.shares()->size() == message.names()->size(),
              "shares", "lists differ in length")
        .texts("states", message.states())
        .that(message.states() == nullptr || message.names() == nullptr ||
                  message.states()->size() == message.names()->size(),
              "states", "lists differ in length")
        .result();
}

Result<void> validate(const wire::Info& message, const Limits& limits) {
    return Checks(limits).name("scene", message.scene()).needs("scene", message.scene()).result();
}

Result<void> validate(const wire::Parts& message, const Limits& limits) {
    return Checks(limits)
        .name("scene", message.scene())
        .needs("scene", message.scene())
        .name("kind", message.kind())
        .result();
}

Result<void> validate(const wire::PartList& message, const Limits& limits) {
    return Checks(limits)
        .names("names", message.names())
        .numbers("triangles", message.names(), message.triangles())
        .numbers("placements", message.names(), message.placements())
        .numbers("records", message.names(), message.records())
        .names("alpha_modes", message.alpha_modes())
        .equally_long("alpha_modes", message.names(), message.alpha_modes())
        .result();
}

Result<void> validate(const wire::Structure& message, const Limits& limits) {
    return Checks(limits)
        .name("scene", message.scene())
        .needs("scene", message.scene())
        .name("kind", message.kind())
        .at_most("count", message.count(), limits.structure_rows_max, "structure_rows_max")
        .aligned("paths", message.paths(), limits.structure_paths_max, "structure_paths_max")
        .that(message.depth_min() <= message.depth_max(), "depth_min", "is above depth_max")
        .result();
}

Result<void> validate(const wire::Path& message, const Limits& limits) {
    return Checks(limits)
        .name("scene", message.scene())
        .needs("scene", message.scene())
        .text("text", message.text())
        .result();
}

Result<void> validate(const wire::PathName& message, const Limits& limits) {
    return Checks(limits)
        .that(message.name() == nullptr || printable(message.name()->string_view()), "name",
              "is not printable UTF-8")
        .names("steps", message.steps())
        .numbers("instances", message.steps(), message.instances())
        .numbers("uids", message.steps(), message.uids())
        .numbers("nodes", message.steps(), message.nodes())
        .result();
}

Result<void> validate(const wire::Unload& message, const Limits& limits) {
    Checks checks(limits);
    checks.name("scene", message.scene());
    if (!message.all() && message.idle_ms() == 0) checks.needs("scene", message.scene());
    return checks.result();
}

Result<void> validate(const wire::Unloaded& message, const Limits& limits) {
    return Checks(limits)
        .name("name", message.name())
        .names("names", message.names())
        .names("holders", message.holders())
        .result();
}

Result<void> validate(const wire::VariantList& message, const Limits& limits) {
    Checks checks(limits);
    if (message.variants() != nullptr)
        for (const wire::Variant* variant : *message.variants())
            checks.nested(variant, check_variant);
    return checks.result();
}

Result<void> validate(const wire::Statistics& message, const Limits& limits) {
    return Checks(limits)
        .names("names", message.names())
        .numbers("values", message.names(), message.values())
        .name("http", message.http())
        .result();
}

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
        .at_most("depth", message.depth(), limits.bounces_max, "bounces_max")
        .finite("ao_distance", static_cast<double>(message.ao_distance()))
        .that(message.ao_distance() >= 0, "ao_distance", "must not be negative")
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

Result<void> validate(const wire::Picture& message, const Limits& limits) {
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
        .name("target", message.target())
        .result();
}

Result<void> validate(const wire::JobList& message, const Limits& limits) {
    Checks checks(limits);
    if (message.jobs() != nullptr)
        for (const wire::JobInfo* info : *message.jobs()) checks.nested(info, check_job_info);
    return checks.result();
}

Result<void> validate(const wire::JobInfo& message, const Limits& limits) {
    Checks checks(limits);
    check_job_info(checks, message);
    return checks.result();
}

}  // namespace raynest::protocol
