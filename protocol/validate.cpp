#include "protocol/validate.h"

#include "protocol/checks.h"

#include <cstdint>

namespace raynest::protocol {
namespace {

/// The box of nothing has its lower corner above the upper one.
void check_box(Checks& checks, const wire::Vec3* lower, const wire::Vec3* upper) {
    if (lower == nullptr || upper == nullptr || lower->x() > upper->x()) return;
    checks.finite("box_min", lower).finite("box_max", upper);
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
        .name("up", info.up())
        .names("variants", info.variants())
        .name("variant", info.variant())
        .text("last_edit", info.last_edit())
        .finite("origin", info.origin_x())
        .finite("origin", info.origin_y())
        .finite("origin", info.origin_z());
    check_box(checks, info.box_min(), info.box_max());
    if (info.animation_seconds() != nullptr && checks.good())
        for (const double seconds : *info.animation_seconds())
            checks.finite("animation_seconds", seconds);
}

void check_param(Checks& checks, const wire::Param& param) {
    checks.named("param", param.name())
        .text("text", param.text())
        .name("type", param.type())
        .names("choices", param.choices());
}

void check_output(Checks& checks, const wire::Output& output) {
    checks.named("output", output.name()).text("text", output.text()).name("type", output.type());
}

void check_variant(Checks& checks, const wire::Variant& variant) {
    checks.named("variant", variant.name())
        .text("text", variant.text())
        .name("target", variant.target())
        .names("targets", variant.targets())
        .names("queries", variant.queries());
    if (variant.params() != nullptr)
        for (const wire::Param* param : *variant.params()) checks.nested(param, check_param);
    if (variant.outputs() != nullptr)
        for (const wire::Output* output : *variant.outputs()) checks.nested(output, check_output);
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
        .name("variant", message.variant())
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
    return Checks(limits)
        .named("scene", message.scene())
        .name("animation", message.animation())
        .finite("time", message.time())
        .result();
}

Result<void> validate(const wire::Parts& message, const Limits& limits) {
    return Checks(limits).named("scene", message.scene()).name("kind", message.kind()).result();
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
        .named("scene", message.scene())
        .name("kind", message.kind())
        .at_most("count", message.count(), limits.structure_rows_max, "structure_rows_max")
        .aligned("paths", message.paths(), limits.structure_paths_max, "structure_paths_max")
        .that(message.depth_min() <= message.depth_max(), "depth_min", "is above depth_max")
        .name("animation", message.animation())
        .finite("time", message.time())
        .result();
}

Result<void> validate(const wire::Export& message, const Limits& limits) {
    return Checks(limits)
        .named("scene", message.scene())
        .name("format", message.format())
        .name("file", message.file())
        .name("animation", message.animation())
        .finite("time", message.time())
        .result();
}

Result<void> validate(const wire::Path& message, const Limits& limits) {
    return Checks(limits).named("scene", message.scene()).text("text", message.text()).result();
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
