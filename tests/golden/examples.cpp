#include "tests/golden/examples.h"

#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <utility>

namespace raynest::golden {
namespace {

using protocol::Bulk;
using protocol::Frame;
using protocol::Result;

template <class T>
void fill(Bulk& bulk, std::size_t index, const std::vector<T>& values) {
    std::memcpy(bulk.block(index).data(), values.data(), values.size() * sizeof(T));
}

Bulk text_bulk(std::string_view text) {
    Bulk bulk;
    bulk.add("data", wire::Dtype::u8, 1, text.size());
    bulk.allocate();
    std::memcpy(bulk.block(0).data(), text.data(), text.size());
    return bulk;
}

class Collection {
public:
    /// `more` tells a further example of a message from its first.
    template <class Native>
    void add(std::uint64_t id, const Native& message, const std::string& more = "") {
        append(protocol::message_of<typename Native::TableType>, protocol::encode(id, message),
               more);
    }
    template <class Native>
    void add(std::uint64_t id, Native message, Bulk bulk, const std::string& more = "") {
        append(protocol::message_of<typename Native::TableType>,
               protocol::encode(id, std::move(message), std::move(bulk)), more);
    }
    std::vector<Example> take() { return std::move(examples_); }

private:
    void append(wire::Message type, Result<Frame> frame, const std::string& more = "") {
        examples_.push_back({wire::EnumNameMessage(type) + more, std::move(frame.value())});
    }
    std::vector<Example> examples_;
};

wire::JobT forest_job() {
    wire::JobT job;
    job.scene = "forest";
    job.intersector = "alpha_mask";
    job.settings = {"cutoff=0.3"};
    job.deadline_ms = 10000;
    return job;
}

std::unique_ptr<wire::SceneInfoT> forest_info() {
    auto info = std::make_unique<wire::SceneInfoT>();
    info->name = "forest";
    info->hash = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08";
    info->epoch = 1;
    info->unique_triangles = 1200;
    info->instanced_triangles = 460763;
    info->instances = 1353;
    info->levels = 3;
    info->materials = 4;
    info->mask_materials = 2;
    info->bytes = 1U << 20;
    info->cameras = {"overview", "low"};
    info->skipped_reasons = {"singular_instances"};
    info->skipped_counts = {1};
    info->warnings = {"node 43 is singular and was skipped"};
    info->record_types = {"sphere"};
    info->record_counts = {20};
    info->box_min = std::make_unique<wire::Vec3>(-1.0F, 0.0F, -1.0F);
    info->box_max = std::make_unique<wire::Vec3>(1.0F, 2.0F, 1.0F);
    return info;
}

void add_connection(Collection& all) {
    wire::HelloT hello;
    hello.client = "raynest 0.1.0";
    hello.window_bytes = 8U << 20;
    all.add(0, hello);

    wire::PingT ping;
    ping.payload = 42;
    all.add(1, ping);

    wire::CancelT cancel;
    cancel.reason = "interrupted";
    all.add(7, cancel);
}

void add_scene_requests(Collection& all) {
    wire::LoadT load;
    load.source = "forest.gltf";
    load.name = "forest";
    load.build = "medium";
    load.file_names = {"forest.gltf", "textures/leaf.png"};
    load.file_hashes = {0xAF63BD4C8601B7BEULL, 0xCBF29CE484222325ULL};
    load.file_bytes = {5, 0};
    all.add(2, load);

    wire::UploadT upload;
    upload.file = 0;
    all.add(2, std::move(upload), text_bulk("{...}"));

    all.add(3, wire::ScenesT{});
    wire::InfoT info;
    info.scene = "forest";
    all.add(4, info);
    wire::PathT path;
    path.scene = "forest";
    path.epoch = 1;
    path.path = 77;
    all.add(5, path);
    wire::UnloadT unload;
    unload.scene = "forest";
    all.add(6, unload);
    all.add(8, wire::VariantsT{});
    all.add(9, wire::StatsT{});
    wire::PartsT parts;
    parts.scene = "forest";
    parts.kind = "meshes";
    all.add(10, parts);
    wire::StructureT structure;
    structure.scene = "forest";
    structure.kind = "boxes";
    structure.level = 1;
    structure.depth_max = 3;
    all.add(11, structure);
    wire::ExportT export_it;
    export_it.scene = "forest";
    export_it.format = "rnscene.json";
    export_it.file = "forest.glb";
    all.add(17, export_it);
    wire::EditT edit;
    edit.scene = "forest";
    edit.epoch = 1;
    edit.targets = {"car#3", "tree-*"};
    edit.rows = 3;
    edit.scenes = {"taxi"};
    edit.names = {"car"};
    edit.vertex_counts = {8};
    edit.keep = true;
    edit.materials = {"red", "7"};
    all.add(16, edit);
    wire::PinT pin;
    pin.scene = "forest";
    all.add(17, pin);
    all.add(18, wire::BackupT{});
    wire::RestoreT restore;
    restore.bytes = 10240;
    restore.scenes = {"alice/forest"};
    all.add(19, restore);
}

void add_work_requests(Collection& all) {
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>(forest_job());
    query.kind = "closest";
    query.fields = {"t", "path"};
    query.ray_count = 2;
    all.add(7, query);

    wire::QueryT sweep;
    sweep.job = std::make_unique<wire::JobT>();
    sweep.job->scene = "forest";
    sweep.kind = "all";
    sweep.max_hits = 4096;
    sweep.fields = {"t"};
    sweep.generator = std::make_unique<wire::GeneratorT>();
    sweep.generator->kind = "lidar";
    sweep.generator->settings = {"elevations=-15,0,15", "azimuths=0:360:1800", "camera=overview"};
    all.add(12, sweep, " of a generator");

    sweep.part_first = 1800;
    sweep.part_count = 900;
    all.add(12, sweep, " of a part");

    Bulk rays;
    rays.add("rays", wire::Dtype::f32, 8, 2);
    rays.allocate();
    fill<float>(rays, 0,
                {0, 1, 5, 0, 0, 0, -1, std::numeric_limits<float>::infinity(),  //
                 0, 9, 5, 0, 0, 0, -1, 100});
    all.add(7, wire::QueryRaysT{}, std::move(rays));
    Bulk masked;
    masked.add("rays", wire::Dtype::f32, 6, 2);
    masked.add("masks", wire::Dtype::u32, 1, 2);
    masked.allocate();
    fill<float>(masked, 0, {0, 1, 5, 0, 0, -1, 0, 9, 5, 0, 0, -1});
    fill<std::uint32_t>(masked, 1, {1, 0xFFFFFFFEU});
    all.add(7, wire::QueryRaysT{}, std::move(masked), " with masks");

    wire::RenderT render;
    render.job = std::make_unique<wire::JobT>(forest_job());
    render.camera = std::make_unique<wire::CameraT>();
    render.camera->name = "overview";
    render.integrator = "primary";
    render.encode = "png";
    all.add(10, render);
    render.tile_x = 64;
    render.tile_y = 8;
    render.tile_width = 128;
    render.tile_height = 16;
    all.add(10, render, " of a tile");

    wire::HeatmapT heatmap;
    heatmap.job = std::make_unique<wire::JobT>(forest_job());
    heatmap.camera = std::make_unique<wire::CameraT>();
    heatmap.camera->look_at = true;
    heatmap.camera->eye = std::make_unique<wire::Vec3>(5.0F, 2.0F, 5.0F);
    heatmap.camera->at = std::make_unique<wire::Vec3>(0.0F, 1.0F, 0.0F);
    heatmap.camera->up = std::make_unique<wire::Vec3>(0.0F, 1.0F, 0.0F);
    heatmap.camera->fov_degrees = 40;
    heatmap.metric = "total";
    heatmap.encode = "raw";
    all.add(11, heatmap);

    wire::ExplainT explain;
    explain.job = std::make_unique<wire::JobT>(forest_job());
    explain.pixel_x = 480;
    explain.pixel_y = 270;
    all.add(13, explain);

    wire::ExplainT explained_ray;
    explained_ray.job = std::make_unique<wire::JobT>(forest_job());
    explained_ray.origin = std::make_unique<wire::Vec3>(0.0F, 1.0F, 5.0F);
    explained_ray.direction = std::make_unique<wire::Vec3>(0.0F, 0.0F, -1.0F);
    explained_ray.tmax = 100;
    explained_ray.steps = 1000;
    all.add(14, explained_ray, " of a ray");

    wire::BlameT blame;
    blame.job = std::make_unique<wire::JobT>(forest_job());
    blame.level = 1;
    blame.top = 20;
    all.add(15, blame);
}

void add_scene_answers(Collection& all) {
    wire::CreditT credit;
    credit.bytes = 1U << 20;
    all.add(7, credit);

    wire::WelcomeT welcome;
    welcome.version = 1;
    welcome.server = "raynestd 0.1.0";
    welcome.window_bytes = 8U << 20;
    welcome.frame_bytes_max = 64U << 20;
    welcome.chunk_rays_max = 16U << 10;
    welcome.jobs_max = 8;
    all.add(0, welcome);

    wire::PongT pong;
    pong.payload = 42;
    all.add(1, pong);

    protocol::Error unknown{protocol::Code::scene_unknown,
                            "scene 'forest' is not loaded; run: raynest load forest.glb", 0};
    wire::ErrorT error;
    error.code = static_cast<std::uint32_t>(unknown.code);
    error.name = protocol::error_info(unknown.code).name;
    error.message = unknown.message;
    all.add(4, error);

    wire::LoadedT loaded;
    loaded.info = forest_info();
    loaded.seconds = 0.5;
    all.add(2, loaded);

    wire::NeedT need;
    need.files = {0};
    all.add(2, need);

    wire::SceneListT list;
    list.total = 1;
    list.names = {"forest"};
    list.hashes = {"9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"};
    list.epochs = {1};
    list.instanced_triangles = {460763};
    list.bytes = {1U << 20};
    list.owners = {"uid:1000"};
    list.age_ms = {90'000};
    list.idle_ms = {1500};
    list.holders = {2};
    all.add(3, list);

    all.add(4, *forest_info());

    wire::PathNameT name;
    name.name = "stand/tree-12";
    name.steps = {"stand", "tree-12"};
    name.instances = {0, 12};
    name.uids = {3, 17};
    name.nodes = {3, 17};
    name.path = 460;
    all.add(5, name);

    wire::PartListT parts;
    parts.total = 1;
    parts.names = {"leaves"};
    parts.triangles = {24};
    parts.placements = {460};
    parts.alpha_modes = {"MASK"};
    parts.records = {0};
    all.add(10, parts);

    wire::UnloadedT unloaded;
    unloaded.name = "forest";
    unloaded.names = {"forest"};
    unloaded.holders = {"uid:1000 (2 connections)"};
    all.add(6, unloaded);

    wire::VariantListT variants;
    variants.total = 1;
    variants.variants.push_back(std::make_unique<wire::VariantT>());
    wire::VariantT& variant = *variants.variants.back();
    variant.name = "alpha_mask";
    variant.text = "a surface stops the ray where its alpha reaches the cutoff";
    variant.target = "v3";
    variant.targets = {"v3", "v2"};
    variant.queries = {"closest", "any", "multi"};
    variant.params.push_back(std::make_unique<wire::ParamT>());
    variant.params.back()->name = "cutoff";
    variant.params.back()->text = "for MASK materials";
    variant.params.back()->type = "f32";
    variant.params.back()->maximum = 1;
    variant.params.back()->initial = 0.5;
    variant.outputs.push_back(std::make_unique<wire::OutputT>());
    variant.outputs.back()->name = "rejects";
    variant.outputs.back()->type = "u32";
    all.add(8, variants);

    wire::StatisticsT statistics;
    statistics.names = {"rays_total", "scenes"};
    statistics.values = {1000, 1};
    all.add(9, statistics);
}

void add_work_answers(Collection& all) {
    wire::StartedT started;
    started.scene = "forest";
    started.hash = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08";
    started.epoch = 1;
    started.intersector = "alpha_mask";
    started.target = "v3";
    started.traversal = "single";
    started.worker = "cpu";
    all.add(7, started);

    Bulk columns;
    columns.add("t", wire::Dtype::f32, 1, 2);
    columns.add("path", wire::Dtype::u64, 1, 2);
    columns.allocate();
    fill<float>(columns, 0, {4.5F, std::numeric_limits<float>::infinity()});
    fill<std::uint64_t>(columns, 1, {77, ~0ULL});
    wire::ChunkT chunk;
    chunk.count = 2;
    all.add(7, std::move(chunk), std::move(columns));

    wire::ProgressT progress;
    progress.done = 1;
    progress.total = 4;
    progress.stage = "tracing";
    all.add(10, progress);

    wire::PayloadT picture;
    picture.width = 2;
    picture.height = 1;
    picture.encode = "raw";
    picture.total = 8;
    Bulk pixels;
    pixels.add("data", wire::Dtype::u8, 4, 2);
    pixels.allocate();
    fill<std::uint8_t>(pixels, 0, {255, 0, 0, 255, 0, 255, 0, 255});
    all.add(10, std::move(picture), std::move(pixels));

    wire::DoneT done;
    done.rays = 2;
    done.hits = 1;
    done.misses = 1;
    done.seconds = 0.25;
    done.traversal = "single";
    done.heat = std::make_unique<wire::HeatStatisticsT>();
    done.heat->metric = "total";
    done.heat->max = 40;
    done.heat->mean = 12.5;
    all.add(7, done);
}

wire::JobInfoT kept_job() {
    wire::JobInfoT info;
    info.job = 17;
    info.owner = "uid:1000";
    info.kind = "query";
    info.detail = "closest";
    info.scene = "forest";
    info.state = "failed";
    info.stage = "tracing";
    info.done = 5;
    info.total = 9;
    info.age_ms = 60000;
    info.left_ms = 3540000;
    info.bytes = 4096;
    info.worker = "cpu";
    info.detached = true;
    info.code = static_cast<std::uint32_t>(protocol::Code::deadline);
    info.error = "the request's deadline passed";
    return info;
}

void add_jobs(Collection& all) {
    wire::JobsT jobs;
    jobs.after = 16;
    all.add(8, jobs);
    wire::JobListT list;
    list.jobs.push_back(std::make_unique<wire::JobInfoT>(kept_job()));
    list.more = true;
    all.add(8, list);
    wire::WaitT wait;
    wait.job = 17;
    wait.deadline_ms = 1000;
    all.add(9, wait);
    all.add(9, kept_job());
    wire::FetchT fetch;
    fetch.job = 17;
    all.add(10, fetch);
    wire::CancelJobT cancel;
    cancel.job = 17;
    all.add(11, cancel);
    wire::DetachedT detached;
    detached.job = 17;
    all.add(12, detached);
}

void add_administration(Collection& all) {
    wire::AdminT admin;
    admin.act = "quota";
    admin.principal = "alice";
    admin.quota = {"jobs=8"};
    all.add(13, admin);
    wire::AdminReportT report;
    report.text = "1 connection";
    report.connections = {7};
    report.principals = {"alice"};
    report.roles = {"user"};
    report.transports = {"tls"};
    report.peers = {"192.0.2.7"};
    report.age_ms = {1500};
    report.jobs = {2};
    all.add(13, report);
    all.add(14, wire::PageT{});
    wire::EditedT edited;
    edited.epoch = 2;
    edited.hash = "60303ae22b998861bce3b28f33eec1be758a213c86c93c076dbe9f558c11c752";
    edited.instances = 41;
    edited.refits = 1;
    edited.seconds = 0.004;
    edited.kept = true;
    all.add(16, edited);
    wire::PinnedT pinned;
    pinned.name = "forest";
    pinned.pinned = true;
    all.add(17, pinned);
    wire::PageAddressT page;
    page.http = "https://192.0.2.7:31061";
    page.code = "7d3f";
    page.code_ms = 120000;
    all.add(14, page);
}

}  // namespace

std::vector<Example> examples() {
    Collection all;
    add_connection(all);
    add_scene_requests(all);
    add_work_requests(all);
    add_scene_answers(all);
    add_work_answers(all);
    add_jobs(all);
    add_administration(all);
    return all.take();
}

}  // namespace raynest::golden
