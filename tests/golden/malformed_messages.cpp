// Messages that FlatBuffers finds sound, and that validate() must refuse: texts, lists, numbers.
#include "tests/golden/malformed_table.h"

#include <array>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <utility>

namespace raynest::golden {
namespace {

void add_bad_texts(Table& table) {
    const std::array<std::pair<const char*, std::string>, 9> texts = {{
        {"an overlong name", std::string(257, 'x')},
        {"a line break", "two\nlines"},
        {"an escape sequence", "\x1b[2J"},
        {"a NUL", std::string("a\0b", 3)},
        {"a delete", "a\x7f"},
        {"half a letter", "\xc3"},
        {"an overlong form", "\xc0\xaf"},
        {"a surrogate", "\xed\xa0\x80"},
        {"a letter beyond Unicode", "\xf4\x90\x80\x80"},
    }};
    for (const auto& entry : texts) {
        const std::string what = entry.first;
        const std::string& text = entry.second;
        const Code code = text.size() > 256 ? Code::limit_exceeded : Code::invalid_field;
        const auto add = [&]<class Native>(const char* message, Native native) {
            table.spoilt(std::string(message) + " with " + what, std::move(native), code);
        };
        wire::InfoT info;
        info.scene = text;
        add("Info", info);
        wire::UnloadT unload;
        unload.scene = text;
        add("Unload", unload);
        wire::PathT path;
        path.scene = text;
        add("Path", path);
        wire::LoadT load;
        load.source = "builtin:forest";
        load.name = text;
        add("Load", load);
        wire::ExportT export_it;
        export_it.scene = "forest";
        export_it.format = "rnscene.json";
        export_it.file = text;
        add("Export", export_it);
        wire::QueryT query;
        query.ray_count = 1;
        query.job = std::make_unique<wire::JobT>();
        query.job->scene = "forest";
        query.job->intersector = text;
        add("Query", query);
    }
}

void add_missing_fields(Table& table) {
    table.spoilt("Info without a scene", wire::InfoT{}, Code::invalid_field);
    table.spoilt("Path without a scene", wire::PathT{}, Code::invalid_field);
    table.spoilt("Unload without a scene", wire::UnloadT{}, Code::invalid_field);
    table.spoilt("Load without a source", wire::LoadT{}, Code::invalid_field);
    wire::ExportT export_it;
    export_it.format = "glb";
    table.spoilt("Export without a scene", export_it, Code::invalid_field);
    export_it.scene = "forest";
    export_it.format = std::string(257, 'g');
    table.spoilt("Export with an overlong format", export_it, Code::limit_exceeded);
    export_it.format = "glb";
    export_it.scene = "two\nlines";
    table.spoilt("Export of a scene with a line break", export_it, Code::invalid_field);
    wire::QueryT query;
    query.ray_count = 1;
    table.spoilt("Query without a job", query, Code::invalid_field);
    query.job = std::make_unique<wire::JobT>();
    table.spoilt("Query without a scene", query, Code::invalid_field);
    table.spoilt("Render without a job", wire::RenderT{}, Code::invalid_field);
    table.spoilt("Heatmap without a job", wire::HeatmapT{}, Code::invalid_field);
    wire::HeatmapT difference;
    difference.job = std::make_unique<wire::JobT>();
    difference.job->scene = "forest";
    difference.other = std::make_unique<wire::JobT>();
    table.spoilt("Heatmap of a difference without its other scene", difference,
                 Code::invalid_field);
    wire::RenderT tile;
    tile.job = std::make_unique<wire::JobT>();
    tile.job->scene = "forest";
    tile.tile_x = 960 - 64;
    tile.tile_width = 65;
    tile.tile_height = 8;
    table.spoilt("Render of a tile beyond the picture", tile, Code::invalid_field);
    tile.tile_x = ~0U;
    table.spoilt("Render of a tile far beyond the picture", tile, Code::invalid_field);
    tile.tile_x = 8;
    tile.tile_width = 0;
    table.spoilt("Render of a tile without a width", tile, Code::invalid_field);
    wire::HeatmapT map_tile;
    map_tile.job = std::make_unique<wire::JobT>();
    map_tile.job->scene = "forest";
    map_tile.tile_y = 1;
    table.spoilt("Heatmap of a tile without a size", map_tile, Code::invalid_field);
    wire::BlameT blame;
    table.spoilt("Blame without a job", blame, Code::invalid_field);
    blame.job = std::make_unique<wire::JobT>();
    blame.job->scene = "forest";
    blame.top = 513;
    table.spoilt("Blame of too many rows", blame, Code::limit_exceeded);
    wire::ExplainT explain;
    table.spoilt("Explain without a job", explain, Code::invalid_field);
    explain.job = std::make_unique<wire::JobT>();
    explain.job->scene = "forest";
    explain.origin = std::make_unique<wire::Vec3>(0.0F, 1.0F, 5.0F);
    table.spoilt("Explain of a ray without a direction", explain, Code::invalid_field);
    explain.origin.reset();
    explain.width = 0;
    table.spoilt("Explain of a picture without width", explain, Code::invalid_field);
    explain.width = 960;
    explain.steps = 16385;
    table.spoilt("Explain of too many steps", explain, Code::limit_exceeded);
}

void add_bad_loads(Table& table) {
    const auto add = [&](const char* name, Code code,
                         const std::function<void(wire::LoadT&)>& spoil) {
        wire::LoadT load;
        load.source = "a.gltf";
        load.file_names = {"a.gltf"};
        load.file_hashes = {1};
        load.file_bytes = {10};
        spoil(load);
        table.spoilt(name, load, code);
    };
    add("Load with a name too few", Code::invalid_field, [](auto& l) { l.file_names = {}; });
    add("Load with a hash too few", Code::invalid_field, [](auto& l) { l.file_hashes = {}; });
    add("Load with half a digest", Code::invalid_field,
        [](auto& l) { l.file_digests.assign(16, 1); });
    add("Load with digests for more files than it has", Code::invalid_field,
        [](auto& l) { l.file_digests.assign(64, 1); });
    add("Load with a digest and too many hashes", Code::invalid_field, [](auto& l) {
        l.file_digests.assign(32, 1);
        l.file_hashes = {1, 2};
    });
    add("Load with a size too many", Code::invalid_field, [](auto& l) { l.file_bytes = {1, 2}; });
    add("Load of 2^63 bytes", Code::limit_exceeded, [](auto& l) { l.file_bytes = {1ULL << 63}; });
    add("Load of sizes that wrap", Code::limit_exceeded, [](auto& l) {
        l.file_names = {"a", "b"};
        l.file_hashes = {1, 2};
        l.file_bytes = {~0ULL, 2};
    });
    add("Load of many large files", Code::limit_exceeded, [](auto& l) {
        l.file_names.assign(8, "a");
        l.file_hashes.assign(8, 1);
        l.file_bytes.assign(8, 1ULL << 30);
    });
    add("Load of 513 files", Code::limit_exceeded, [](auto& l) {
        l.file_names.assign(513, "a");
        l.file_hashes.assign(513, 1);
        l.file_bytes.assign(513, 1);
    });
    constexpr double none = std::numeric_limits<double>::quiet_NaN();
    add("Load with a unit that is no number", Code::invalid_field, [](auto& l) { l.unit = none; });
    add("Load with a radius that is no number", Code::invalid_field,
        [](auto& l) { l.radius = none; });
    add("Load with a spacing that is no number", Code::invalid_field,
        [](auto& l) { l.spacing = none; });
    add("Load of an overlong source", Code::limit_exceeded,
        [](auto& l) { l.source = std::string(4097, 'x'); });
}

void add_bad_queries(Table& table) {
    const auto add = [&](const char* name, Code code,
                         const std::function<void(wire::QueryT&)>& spoil) {
        wire::QueryT query;
        query.job = std::make_unique<wire::JobT>();
        query.job->scene = "forest";
        query.ray_count = 1;
        spoil(query);
        table.spoilt(name, query, code);
    };
    add("Query of no rays", Code::invalid_field, [](auto& q) { q.ray_count = 0; });
    add("Query of 2^63 rays", Code::limit_exceeded, [](auto& q) { q.ray_count = 1ULL << 63; });
    add("Query of one ray too many", Code::limit_exceeded,
        [](auto& q) { q.ray_count = (1ULL << 36) + 1; });
    add("Query for 257 hits", Code::limit_exceeded, [](auto& q) { q.max_hits = 257; });
    add("Query for 65537 hits of kind all", Code::limit_exceeded, [](auto& q) {
        q.kind = "all";
        q.max_hits = 65537;
    });
    add("Query for 2^32 - 1 hits", Code::limit_exceeded, [](auto& q) { q.max_hits = ~0U; });
    add("Query of 513 fields", Code::limit_exceeded, [](auto& q) { q.fields.assign(513, "t"); });
    add("Query of an overlong field", Code::limit_exceeded,
        [](auto& q) { q.fields = {std::string(300, 't')}; });
    add("Query of a part of sent rays", Code::invalid_field, [](auto& q) { q.part_first = 1; });
    add("Query of a part beyond 2^36 rays", Code::limit_exceeded,
        [](auto& q) { q.part_first = (1ULL << 36) + 1; });
    add("Query with a setting without a value", Code::invalid_field,
        [](auto& q) { q.job->settings = {"cutoff"}; });
    add("Query with 513 settings", Code::limit_exceeded,
        [](auto& q) { q.job->settings.assign(513, "a=1"); });
    const auto add_table = [](wire::QueryT& q, const char* name, std::size_t values) {
        q.job->tables.push_back(std::make_unique<wire::ParamTableT>());
        q.job->tables.back()->name = name;
        q.job->tables.back()->values.resize(values);
    };
    add("Query with a nameless table", Code::invalid_field, [&](auto& q) { add_table(q, "", 1); });
    add("Query with 8193 values in two tables", Code::limit_exceeded, [&](auto& q) {
        add_table(q, "curve", 8192);
        add_table(q, "ids", 1);
    });
}

void add_bad_generators(Table& table) {
    const auto add = [&](const char* name, Code code,
                         const std::function<void(wire::QueryT&, wire::GeneratorT&)>& spoil) {
        wire::QueryT query;
        query.job = std::make_unique<wire::JobT>();
        query.job->scene = "forest";
        query.generator = std::make_unique<wire::GeneratorT>();
        query.generator->kind = "lidar";
        query.generator->settings = {"elevations=0,1", "azimuths=0:360:4"};
        spoil(query, *query.generator);
        table.spoilt(name, query, code);
    };
    add("Query of a nameless generator", Code::invalid_field, [](auto&, auto& g) { g.kind = ""; });
    add("Query of a generator with a setting without a value", Code::invalid_field,
        [](auto&, auto& g) { g.settings = {"samples"}; });
    add("Query of a generator with 513 settings", Code::limit_exceeded,
        [](auto&, auto& g) { g.settings.assign(513, "a=1"); });
    add("Query of a generator with a control character", Code::invalid_field,
        [](auto&, auto& g) { g.settings = {"camera=\x1b[2J"}; });
    add("Query of an overlong reducer", Code::limit_exceeded,
        [](auto& q, auto&) { q.reduce = std::string(257, 'r'); });
}

template <class Native>
void add_bad_pictures(Table& table, const std::string& message) {
    const auto add = [&](const char* what, Code code, const std::function<void(Native&)>& spoil) {
        Native picture;
        picture.job = std::make_unique<wire::JobT>();
        picture.job->scene = "forest";
        picture.camera = std::make_unique<wire::CameraT>();
        picture.camera->eye = std::make_unique<wire::Vec3>(0.0F, 0.0F, 0.0F);
        picture.camera->at = std::make_unique<wire::Vec3>(0.0F, 0.0F, -1.0F);
        picture.camera->up = std::make_unique<wire::Vec3>(0.0F, 1.0F, 0.0F);
        spoil(picture);
        table.spoilt(message + " " + what, picture, code);
    };
    constexpr float infinite = std::numeric_limits<float>::infinity();
    constexpr float nan = std::numeric_limits<float>::quiet_NaN();
    add("of no width", Code::invalid_field, [](auto& p) { p.width = 0; });
    add("of no height", Code::invalid_field, [](auto& p) { p.height = 0; });
    add("16385 wide", Code::limit_exceeded, [](auto& p) { p.width = 16385; });
    add("2^32 - 1 high", Code::limit_exceeded, [](auto& p) { p.height = ~0U; });
    add("of too many pixels", Code::limit_exceeded, [](auto& p) { p.width = p.height = 16000; });
    add("of 180 degrees", Code::invalid_field, [](auto& p) { p.camera->fov_degrees = 180; });
    add("of a negative angle", Code::invalid_field, [](auto& p) { p.camera->fov_degrees = -1; });
    add("of a NaN angle", Code::invalid_field, [=](auto& p) { p.camera->fov_degrees = nan; });
    add("from infinity", Code::invalid_field,
        [=](auto& p) { *p.camera->eye = wire::Vec3(infinite, 0, 0); });
    add("looking at NaN", Code::invalid_field,
        [=](auto& p) { *p.camera->at = wire::Vec3(0, nan, 0); });
    add("with NaN above", Code::invalid_field,
        [=](auto& p) { *p.camera->up = wire::Vec3(0, 0, nan); });
    add("looking from nowhere", Code::invalid_field, [](auto& p) {
        p.camera->look_at = true;
        p.camera->eye.reset();
    });
    add("with an overlong encoding", Code::limit_exceeded,
        [](auto& p) { p.encode = std::string(257, 'p'); });
    add("with a broken camera name", Code::invalid_field, [](auto& p) { p.camera->name = "\x80"; });
}

void add_bad_numbers(Table& table) {
    wire::CreditT credit;
    table.spoilt("Credit of nothing", credit, Code::invalid_field);
    for (const std::uint64_t bytes : {(32ULL << 20) + 1, 1ULL << 63, ~0ULL}) {
        credit.bytes = bytes;
        table.spoilt("Credit of " + std::to_string(bytes), credit, Code::limit_exceeded);
    }
    wire::RenderT render;
    render.job = std::make_unique<wire::JobT>();
    render.job->scene = "forest";
    render.samples = 0;
    table.spoilt("Render of no samples", render, Code::invalid_field);
    render.samples = ~0U;
    table.spoilt("Render of too many samples", render, Code::limit_exceeded);
    wire::CancelT cancel;
    cancel.reason = std::string(4097, 'x');
    table.spoilt("Cancel with an overlong reason", cancel, Code::limit_exceeded);
    wire::EditT edit;
    edit.scene = "forest";
    edit.rows = 1;
    edit.vertex_counts = {8, 4};
    const std::pair<const char*, std::vector<std::uint32_t>> unfit[] = {
        {"Edit with fewer normals than vertices", {7, 0}},
        {"Edit with normals of one mesh of two", {8}},
        {"Edit with normals of a mesh too many", {8, 4, 0}},
        {"Edit with more normals than vertices", {0, ~0U}}};
    for (const auto& [name, counts] : unfit) {
        edit.normal_counts = counts;
        table.spoilt(name, edit, Code::invalid_field);
    }
}

}  // namespace

void add_malformed_messages(Table& table) {
    add_bad_texts(table);
    add_missing_fields(table);
    add_bad_loads(table);
    add_bad_queries(table);
    add_bad_generators(table);
    add_bad_pictures<wire::RenderT>(table, "Render");
    add_bad_pictures<wire::HeatmapT>(table, "Heatmap");
    add_bad_numbers(table);
}

}  // namespace raynest::golden
