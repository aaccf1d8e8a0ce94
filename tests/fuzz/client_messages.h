// Messages of a client whose contents a fuzzer chooses, byte by byte.
#pragma once

#include "protocol/edit_row.h"
#include "protocol/frame.h"
#include "protocol/wire.h"
#include "tests/golden/examples.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace raynest::fuzz {

/// The input, byte by byte; zeros after its end.
class Program {
public:
    explicit Program(std::span<const std::uint8_t> bytes) : bytes_(bytes) {}
    [[nodiscard]] bool ended() const { return bytes_.empty(); }
    std::uint8_t byte() {
        if (bytes_.empty()) return 0;
        const std::uint8_t first = bytes_.front();
        bytes_ = bytes_.subspan(1);
        return first;
    }
    std::uint64_t below(std::uint64_t end) { return byte() % end; }
    template <std::size_t n>
    const char* word(const std::array<const char*, n>& words) {
        return words[below(n)];
    }

private:
    std::span<const std::uint8_t> bytes_;
};

/// Requests use ids from 1 to this, so that ids collide.
inline constexpr std::uint64_t ids = 4;

inline std::unique_ptr<wire::JobT> job(Program& program) {
    auto job = std::make_unique<wire::JobT>();
    job->scene = "forest";
    job->intersector = program.word<4>({"auto", "opaque", "alpha_mask", "procedural_mask"});
    job->traversal = program.word<5>({"auto", "single", "stream", "packet", "reference"});
    job->priority = program.word<3>({"normal", "low", "high"});
    job->epoch = program.below(3);
    const std::uint64_t more = program.below(8);
    job->deadline_ms = more == 1 ? 1 : 0;
    if (more > 3) job->scene = "mine";
    return job;
}

inline wire::QueryT query(Program& program) {
    constexpr std::array<const char*, 12> columns = {"t",   "prim",  "path",     "uv",
                                                     "ng",  "front", "position", "flags",
                                                     "hit", "nodes", "total",    "rejects"};
    wire::QueryT query;
    query.job = job(program);
    query.kind = program.word<3>({"closest", "any", "multi"});
    for (std::uint64_t count = program.below(4); count > 0; --count)
        query.fields.emplace_back(program.word(columns));
    query.max_hits = static_cast<std::uint32_t>(1 + program.below(256));
    query.ray_count = 1 + program.below(200);
    return query;
}

inline protocol::Frame rays(Program& program, std::uint64_t id, std::uint64_t first) {
    protocol::Bulk bulk;
    const std::array<std::uint32_t, 3> widths = {8, 6, 3};
    bulk.add("rays", wire::Dtype::f32, widths[program.below(widths.size())], 1 + program.below(80));
    bulk.allocate();
    constexpr std::array<float, 16> numbers = {0,     1,      -1,     0.5F,   2,     5,  0.1F, 10,
                                               1e30F, -1e30F, 1e-38F, 1e-45F, -0.0F, 20, 4,    3};
    std::array<float, 8> ray{};
    for (float& value : ray) value = numbers[program.below(numbers.size())];
    const std::span<float> values = bulk.block_as<float>(0);
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = ray[i % 8];
    wire::QueryRaysT message;
    message.first_ray = first;
    // Half of the frames state values that their rays lack, or contain.
    if (program.below(2) == 0)
        message.origin = std::make_unique<wire::Vec3>(ray[0], ray[1], ray[2]);
    if (program.below(2) == 0) message.tmin = ray[3], message.tmax = ray[4];
    return protocol::encode(id, std::move(message), std::move(bulk)).value();
}

template <class Picture>
Picture picture(Program& program) {
    Picture picture;
    picture.job = job(program);
    picture.camera = std::make_unique<wire::CameraT>();
    picture.camera->look_at = true;
    picture.camera->eye = std::make_unique<wire::Vec3>(5.0F, 5.0F, 5.0F);
    picture.camera->at = std::make_unique<wire::Vec3>(0.0F, 0.0F, 0.0F);
    picture.width = static_cast<std::uint32_t>(1 + program.below(80));
    picture.height = static_cast<std::uint32_t>(1 + program.below(40));
    picture.encode = "raw";
    return picture;
}

inline wire::LoadT load(Program& program) {
    wire::LoadT load;
    load.source = program.word<4>({"a.glb", "builtin:flake", "root:a.glb", "a.npy"});
    load.name = "new";
    load.replace = program.below(2) == 0;
    for (std::uint64_t files = program.below(4); files > 0; --files) {
        load.file_names.push_back(std::to_string(files) + ".bin");
        load.file_hashes.push_back(0xCBF29CE484222325ULL);
        load.file_bytes.push_back(64 * program.below(64));
    }
    // Digests of nothing, so that the corpus keeps its meaning without a byte more.
    if (load.replace) load.file_digests.assign(32 * load.file_names.size(), 7);
    return load;
}

inline wire::ExportT export_of(Program& program) {
    wire::ExportT message;
    message.scene = program.word<3>({"forest", "forest", "gone"});
    message.format = program.word<4>({"glb", "rnscene.json", "glb", "obj"});
    message.file = program.word<4>({"a.glb", "", "a/b.glb", "../a.glb"});
    message.epoch = program.below(3);
    return message;
}

inline wire::EditT edit(Program& program) {
    wire::EditT message;
    message.scene = program.word<4>({"mine", "mine", "mine", "gone"});
    message.epoch = program.below(4);
    for (std::uint64_t count = program.below(4); count > 0; --count)
        message.targets.emplace_back(program.word<4>({"first", "*/low", "second/*", "none"}));
    message.rows = static_cast<std::uint32_t>(1 + program.below(4));
    if (program.below(2) == 1) message.scenes = {"forest"}, message.names = {"car"};
    if (program.below(4) == 1) message.vertex_counts = {4};
    message.materials = {program.word<2>({"0", "red"})};
    message.keep = program.below(8) == 1;
    return message;
}

/// The rows of an edit, and as many vertices of a mesh.
inline protocol::Frame edit_rows(Program& program, std::uint64_t id, std::uint32_t rows,
                                 std::uint32_t vertices) {
    std::vector<std::byte> bytes;
    const auto append = [&bytes](const auto& value) {
        const auto more = std::as_bytes(std::span(&value, 1));
        bytes.insert(bytes.end(), more.begin(), more.end());
    };
    constexpr std::array<double, 8> numbers = {1, 0, 2, -3, 1e30, 0.5, 1e-30, std::nan("")};
    for (std::uint32_t i = 0; i < rows; ++i) {
        protocol::EditRow row{};
        row.what = static_cast<std::uint32_t>(program.below(protocol::EditRow::what_count + 1));
        row.by = static_cast<std::uint32_t>(program.below(protocol::EditRow::by_count + 1));
        row.target = static_cast<std::uint32_t>(program.below(6));
        row.value = static_cast<std::uint32_t>(program.below(6));
        row.m[0] = row.m[5] = row.m[10] = numbers[program.below(numbers.size())];
        row.m[3] = numbers[program.below(numbers.size())];
        append(row);
    }
    for (std::uint32_t i = 0; i < 3 * vertices; ++i)
        append(static_cast<float>(numbers[program.below(numbers.size())]));
    protocol::Bulk bulk;
    bulk.add("data", wire::Dtype::u8, 1, bytes.size());
    bulk.allocate();
    std::ranges::copy(bytes, bulk.block(0).data());
    return protocol::encode(id, wire::UploadT{}, std::move(bulk)).value();
}

inline protocol::Frame upload(Program& program, std::uint64_t id) {
    wire::UploadT piece;
    piece.file = static_cast<std::uint32_t>(program.below(4));
    piece.offset = 64 * program.below(64);
    protocol::Bulk bulk;
    bulk.add("data", wire::Dtype::u8, 1, 64 * program.below(64));
    bulk.allocate();
    std::ranges::fill(bulk.block(0), std::byte{7});
    return protocol::encode(id, std::move(piece), std::move(bulk)).value();
}

inline protocol::Frame example(Program& program) {
    static const std::vector<golden::Example> examples = golden::examples();
    protocol::Frame copy = golden::copy(examples[program.below(examples.size())].frame);
    if (const std::uint64_t other = program.below(2 * ids); other < ids)
        copy.header.request_id = other;
    return copy;
}

inline void damage(Program& program, protocol::Frame& frame) {
    for (std::uint64_t count = 1 + program.below(3); count > 0; --count) {
        const std::size_t at = program.byte() + std::size_t{256} * program.below(2);
        if (at < frame.control.size())
            frame.control.data()[at] = static_cast<std::byte>(program.byte());
    }
}

}  // namespace raynest::fuzz
