// Reads what follows a request in bulk: the rows of an edit, the rays and masks of a query, the
// trajectory of a sweep, and the steps that its order is cut into.
//
// The first byte of the input says which; the rest is the payload.
#include "engine/scene/edits/batch.h"
#include "engine/scene/edits/edit.h"
#include "server/execution/ray_input.h"
#include "server/execution/step_order.h"
#include "server/execution/trajectory.h"
#include "server/jobs/edit_rows.h"
#include "tests/fuzz/target.h"
#include "tests/unit/engine/rich_scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <span>
#include <vector>

using namespace raynest;
using server::EditRow;

namespace {

enum What : std::uint8_t { rows, rays, trajectory, steps, what_count };

const Snapshot& scene() {
    static const std::shared_ptr<const Snapshot> scene = test::rich_scene(false);
    return *scene;
}

/// Copies the values of some bytes to where they are aligned; the rest is left away.
template <class T>
std::vector<T> numbers(std::span<const std::uint8_t> bytes) {
    std::vector<T> all(bytes.size() / sizeof(T));
    if (!all.empty()) std::memcpy(all.data(), bytes.data(), all.size() * sizeof(T));
    return all;
}

void read_rows(std::span<const std::uint8_t> bytes) {
    const std::vector<EditRow> all = numbers<EditRow>(bytes);
    const std::vector<Vec3> vertices = numbers<Vec3>(bytes.subspan(all.size() * sizeof(EditRow)));
    server::EditContent content;
    content.targets = {"*", "first", "third"};
    content.rows = static_cast<std::uint32_t>(all.size());
    // The second half of an even number is normals.
    const bool halved = vertices.size() % 2 == 0;
    const auto count = static_cast<std::uint32_t>(vertices.size() / (halved ? 2 : 1));
    content.vertex_counts = {count};
    if (halved) content.normal_counts = {count};
    std::vector<std::byte> payload(content.bytes());
    if (!all.empty()) std::memcpy(payload.data(), all.data(), all.size() * sizeof(EditRow));
    if (!vertices.empty())
        std::memcpy(payload.data() + all.size() * sizeof(EditRow), vertices.data(),
                    vertices.size() * sizeof(Vec3));
    EditBatch batch(scene());
    if (!server::read_edit(batch, scene(), "scene", content, payload, {})) return;
    const auto edited = edit_scene(scene(), batch.changes());
    // An edited scene opens as a loaded one does.
    if (edited) fuzz::require((*edited)->view().object_count != 0);
}

void read_rays(std::span<const std::uint8_t> bytes) {
    if (bytes.size() < 4) return;
    constexpr std::array<std::uint32_t, 4> widths{8, 6, 3, 5};
    const std::uint32_t width = widths[bytes[0] % widths.size()];
    const std::uint64_t count = bytes[1], masks = bytes[2];
    const bool masked = bytes[3] % 2 != 0;
    bytes = bytes.subspan(4);
    protocol::Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, width, count);
    if (masked)
        bulk.add("masks", bytes.size() % 5 == 0 ? wire::Dtype::f32 : wire::Dtype::u32, 1, masks);
    bulk.allocate();
    for (std::size_t block = 0; block < bulk.count(); ++block) {
        const std::span<std::byte> to = bulk.block(block);
        std::ranges::fill(to, std::byte{1});
        const std::size_t some = std::min(to.size(), bytes.size());
        if (some != 0) std::memcpy(to.data(), bytes.data(), some);
        bytes = bytes.subspan(some);
    }
    wire::QueryRaysT message;
    if (width == 3) message.origin = std::make_unique<wire::Vec3>(0.F, 1.F, 2.F);
    auto frame = protocol::encode(1, std::move(message), std::move(bulk));
    if (!frame) return;
    server::Budget budget(1 << 20);
    const protocol::Limits limits;
    server::RayInput input(count, 1, limits, budget, "nobody");
    const auto taken = input.feed(std::move(*frame));
    if (!taken) return;
    fuzz::require(*taken == count && (!masked || masks == count));
    server::TraceBuffers buffers(budget);
    const auto each = input.masks(0, count, buffers);
    if (each) fuzz::require(each->size() == (masked ? count : 0));
    fuzz::require(input.sent(0, count, buffers).size() == count);
}

void read_trajectory(std::span<const std::uint8_t> bytes) {
    std::vector<double> all = numbers<double>(bytes);
    all.resize(all.size() / server::Trajectory::row_numbers * server::Trajectory::row_numbers);
    const auto made = server::Trajectory::of(all);
    if (!made) return;
    for (const double share : {0.0, 0.25, 0.5, 1.0}) {
        const double time = (1 - share) * made->begin() + share * made->end();
        const Pose pose = made->at(std::clamp(time, made->begin(), made->end()));
        for (const glm::dvec3& axis : {pose.x, pose.y, pose.z})
            fuzz::require(std::abs(glm::length(axis) - 1) < 1e-2);
    }
}

/// Each ray has one place, and runs lead to it.
void order_steps(std::span<const std::uint8_t> bytes) {
    if (bytes.size() < 6) return;
    const server::SweepGrid grid{1 + bytes[0] % 40U, 1 + bytes[1] % 9U, 1 + bytes[2] % 5U};
    const std::uint64_t all = grid.columns * grid.channels * grid.scans;
    const std::uint64_t first = all * bytes[3] / 256;
    const std::uint64_t count = 1 + (all - first - 1) * bytes[4] / 255;
    std::vector<std::uint64_t> cuts;
    for (std::size_t i = 6; i < bytes.size() && i < 9; ++i)
        cuts.push_back(bytes[i] * grid.columns * grid.scans / 256);
    std::ranges::sort(cuts);
    const server::StepOrder order(grid, first, count, 1 + bytes[5] % 50U, cuts);
    for (const std::uint64_t cut : cuts)
        for (const auto& step : order.steps())
            fuzz::require(step.scan != cut / grid.columns || cut % grid.columns <= step.begin ||
                          cut % grid.columns >= step.end);
    std::vector<std::uint64_t> place_of(count, count);
    std::uint64_t places = 0;
    for (const auto& step : order.steps()) {
        fuzz::require(step.first == places && step.count != 0);
        std::vector<std::uint64_t> numbers(step.count);
        order.numbers(step.first, numbers);
        for (const std::uint64_t number : numbers) {
            fuzz::require(number >= first && number - first < count);
            fuzz::require(number % grid.columns >= step.begin && number % grid.columns < step.end);
            std::uint64_t& place = place_of[number - first];
            fuzz::require(place == count);
            place = places++;
        }
    }
    fuzz::require(places == count);
    for (std::uint64_t ray = 0; ray < count;) {
        const auto run = order.run_at(ray);
        fuzz::require(run.count != 0 && run.count <= count - ray);
        for (std::uint64_t i = 0; i < run.count; ++i)
            fuzz::require(place_of[ray + i] == run.place + i);
        ray += run.count;
    }
}

fuzz::Input seed(What what, const void* data, std::size_t bytes) {
    fuzz::Input input(1 + bytes);
    input[0] = what;
    if (bytes != 0) std::memcpy(input.data() + 1, data, bytes);
    return input;
}

}  // namespace

std::vector<fuzz::Input> fuzz::seeds() {
    std::vector<Input> seeds;
    std::vector<EditRow> edits;
    for (std::uint32_t what = 0; what < EditRow::add; ++what) {
        EditRow row{what, 0, what % 2, what == EditRow::set_mask ? 3U : 0U, {}};
        row.m[0] = row.m[5] = row.m[10] = 1;
        row.m[3] = what;
        edits.push_back(row);
        seeds.push_back(seed(rows, &row, sizeof row));
    }
    seeds.push_back(seed(rows, edits.data(), edits.size() * sizeof(EditRow)));
    for (std::uint8_t width = 0; width < 3; ++width) {
        std::array<std::uint8_t, 260> bytes{width, 4, 4, 1};
        seeds.push_back(seed(rays, bytes.data(), bytes.size()));
    }
    std::array<double, 39> poses{};
    for (std::size_t i = 0; i < 3; ++i) {
        double* const row = poses.data() + 13 * i;
        row[0] = static_cast<double>(i);
        row[1] = row[6] = row[11] = 1;
        row[4] = static_cast<double>(5 * i);
    }
    seeds.push_back(seed(trajectory, poses.data(), sizeof poses));
    const std::array<std::uint8_t, 6> order{29, 6, 2, 10, 240, 7};
    seeds.push_back(seed(steps, order.data(), order.size()));
    return seeds;
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size == 0) return 0;
    const std::span<const std::uint8_t> rest(data + 1, size - 1);
    switch (data[0] % what_count) {
        case rows:
            read_rows(rest);
            break;
        case rays:
            read_rays(rest);
            break;
        case trajectory:
            read_trajectory(rest);
            break;
        default:
            order_steps(rest);
    }
    return 0;
}
