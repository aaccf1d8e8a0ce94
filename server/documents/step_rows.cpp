#include "server/documents/step_rows.h"

#include "engine/queries/columns.h"

#include <algorithm>
#include <cstring>
#include <utility>

namespace raynest::server {
namespace {

bool is_of_hits(std::string_view name) {
    const auto column = parse_column(name);
    return column && !field_info(column->field).of_ray;
}

}  // namespace

std::uint64_t StepRows::Part::hits_begin() const {
    return kept->splits.empty() ? first : kept->splits[first];
}

std::uint64_t StepRows::Part::hits() const {
    return kept->splits.empty() ? count : kept->splits[first + count] - kept->splits[first];
}

Reply<void> StepRows::add(const StepOrder& order, protocol::Frame frame) {
    auto kept = std::make_unique<KeptChunk>();
    const std::uint64_t bytes = frame.header.frame_bytes();
    auto lease = budget_.reserve(bytes, principal_);
    if (!lease)
        return budget_.refuse("a scan's answer", bytes, principal_,
                              "ask for fewer columns, channels or fields");
    kept->lease = std::move(*lease);
    kept->frame = std::move(frame);
    auto chunk = protocol::open<wire::Chunk>(kept->frame);
    if (!chunk) return tl::unexpected(chunk.error());
    kept->chunk = std::move(*chunk);
    if (const auto* splits = protocol::find_block(kept->chunk.blocks, splits_column))
        kept->splits = splits->values<std::uint64_t>();
    const std::lock_guard lock(mutex_);
    if (scans_.empty()) scans_.resize(order.scans().size());
    Scan& scan = scans_[order.scan_at(kept->chunk->first_ray())];
    scan.arrived += kept->chunk->count();
    scan.chunks.push_back(std::move(kept));
    return {};
}

std::optional<Task> StepRows::next(const StepOrder& order) {
    if (turn_ != Turn::io || scan_ == order.scans().size()) return std::nullopt;
    {
        const std::lock_guard lock(mutex_);
        if (scans_.empty() || scans_[scan_].arrived != order.scans()[scan_].count)
            return std::nullopt;
    }
    turn_ = Turn::runs;
    Task task;
    task.reply_bytes_max = most_.bytes;
    task.run = [this, &order](const Stop&) {
        auto frames = make_frame(order);
        if (frames) turn_ = Turn::ran;
        return frames;
    };
    return task;
}

void StepRows::ended() {
    if (turn_ == Turn::ran) turn_ = Turn::io;
}

std::vector<StepRows::Part> StepRows::next_parts(const StepOrder& order) const {
    const auto& chunks = scans_[scan_].chunks;
    const StepOrder::Scan& scan = order.scans()[scan_];
    std::vector<Part> parts;
    std::uint64_t rays = 0, hits = 0;
    std::uint64_t ray = handed_out_;
    while (ray < scan.first + scan.count && rays < most_.rays) {
        const StepOrder::Run run = order.run_at(ray);
        const auto behind = std::ranges::upper_bound(
            chunks, run.place, {}, [](const auto& kept) { return kept->chunk->first_ray(); });
        const KeptChunk& kept = **std::prev(behind);
        const std::uint64_t first = run.place - kept.chunk->first_ray();
        Part part{&kept, first,
                  std::min({run.count, kept.chunk->count() - first, most_.rays - rays})};
        // A ray fits alone.
        while (part.count > (rays == 0 ? 1 : 0) &&
               cost_.bytes(rays + part.count, hits + part.hits()) > most_.bytes)
            --part.count;
        if (part.count == 0) break;
        const bool is_cut = part.count < std::min(run.count, kept.chunk->count() - first);
        parts.push_back(part);
        rays += part.count, hits += part.hits(), ray += part.count;
        if (is_cut) break;
    }
    return parts;
}

Reply<Frames> StepRows::make_frame(const StepOrder& order) {
    auto& chunks = scans_[scan_].chunks;
    if (!std::exchange(is_sorted_, true))
        std::ranges::sort(chunks, {}, [](const auto& kept) { return kept->chunk->first_ray(); });
    const std::vector<Part> parts = next_parts(order);
    std::uint64_t rays = 0, hits = 0;
    for (const Part& part : parts) rays += part.count, hits += part.hits();

    const auto& shape = parts.front().kept->chunk.blocks;
    const bool many = !parts.front().kept->splits.empty();
    protocol::Bulk bulk;
    for (const protocol::BlockView& block : shape)
        bulk.add(block.name, block.dtype, block.width(),
                 block.name == splits_column      ? rays + 1
                 : many && is_of_hits(block.name) ? hits
                                                  : rays);
    bulk.allocate();
    for (std::size_t b = 0; b < shape.size(); ++b) {
        if (shape[b].name == splits_column) {
            std::uint64_t* to = bulk.block_as<std::uint64_t>(b).data();
            std::uint64_t end = *to++ = 0;
            for (const Part& part : parts)
                for (std::uint64_t i = 0; i < part.count; ++i)
                    *to++ = end +=
                        part.kept->splits[part.first + i + 1] - part.kept->splits[part.first + i];
            continue;
        }
        const bool of_hits = many && is_of_hits(shape[b].name);
        std::byte* to = bulk.block(b).data();
        const std::uint64_t each = shape[b].stride;
        for (const Part& part : parts) {
            const std::uint64_t count = of_hits ? part.hits() : part.count;
            const std::uint64_t first = of_hits ? part.hits_begin() : part.first;
            if (count == 0) continue;
            std::memcpy(to, part.kept->chunk.blocks[b].bytes.data() + first * each, count * each);
            to += count * each;
        }
    }
    wire::ChunkT chunk;
    chunk.first_ray = handed_out_;
    chunk.count = static_cast<std::uint32_t>(rays);
    auto frame = protocol::encode(id_, std::move(chunk), std::move(bulk));
    if (!frame) return tl::unexpected(frame.error());
    handed_out_ += rays;
    if (const auto& scan = order.scans()[scan_]; handed_out_ == scan.first + scan.count) {
        chunks.clear();
        is_sorted_ = false;
        ++scan_;
    }
    Frames frames;
    frames.push_back(std::move(*frame));
    return frames;
}

}  // namespace raynest::server
