#include "client/requests/query.h"

#include "client/requests/scene_origin.h"

#include <array>
#include <chrono>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::client {
namespace {

using protocol::BlockView;

/// Bytes of chunks that wait for one before them: more than an honest daemon leaves out so long.
constexpr std::uint64_t waiting_bytes_max = 1ULL << 30;

/// True for a column of the type that the list of columns has for it; outputs of an intersector, and
/// columns of later daemons, may have any.
bool has_known_type(const BlockView& block) {
    struct Type {
        std::string_view word;
        wire::Dtype dtype;
        std::uint32_t width;
    };
    static constexpr std::array types = {
        Type{"u8", wire::Dtype::u8, 1},    Type{"truth", wire::Dtype::u8, 1},
        Type{"u32", wire::Dtype::u32, 1},  Type{"u64", wire::Dtype::u64, 1},
        Type{"f32", wire::Dtype::f32, 1},  Type{"vec2", wire::Dtype::f32, 2},
        Type{"vec3", wire::Dtype::f32, 3}, Type{"point", wire::Dtype::f32, 3}};
    const auto column = std::ranges::find(column_words, block.name, &ColumnWords::name);
    if (column == column_words.end()) return true;
    const auto type = std::ranges::find(types, column->type, &Type::word);
    return type != types.end() && block.dtype == type->dtype && block.width() == type->width;
}

/// Puts chunks in order: keeps each until all before it have come.
class ChunkReorderer {
public:
    /// `fields` must all come.
    ChunkReorderer(bool splits, const Outcome& outcome,
                   const std::function<Result<void>(const QueryChunk&)>& consume,
                   const std::vector<std::string>& fields)
        : splits_(splits),
          outcome_(outcome),
          consume_(consume),
          fields_(fields.begin(), fields.end()) {}

    /// Adds a chunk of an answer that has at most `rows` rows.
    Result<void> add(protocol::Frame frame, std::uint64_t rows) {
        auto chunk = open_reply<wire::Chunk>(std::move(frame));
        if (!chunk) return tl::unexpected<Failure>(chunk.error());
        const std::uint64_t first = (*chunk)->first_ray();
        if ((*chunk)->count() == 0 || first < next_ || first >= rows ||
            (*chunk)->count() > rows - first)
            return daemon_sent("answers to rays that were not asked");
        waiting_bytes_ += chunk->frame.header.frame_bytes();
        if (!waiting_.emplace(first, std::move(*chunk)).second)
            return daemon_sent("an answer twice");
        while (!waiting_.empty() && waiting_.begin()->first == next_) {
            if (auto passed = pass_on(waiting_.begin()->second); !passed) return passed;
            next_ += waiting_.begin()->second->count();
            waiting_bytes_ -= waiting_.begin()->second.frame.header.frame_bytes();
            waiting_.erase(waiting_.begin());
        }
        if (waiting_bytes_ <= waiting_bytes_max) return {};
        return daemon_sent("answers for long without that to ray " + std::to_string(next_));
    }
    [[nodiscard]] std::uint64_t answered() const { return next_; }

private:
    Result<void> pass_on(const Reply<wire::Chunk>& reply) {
        QueryChunk chunk;
        chunk.first_ray = reply->first_ray();
        chunk.count = reply->count();
        std::vector<BlockView> columns;
        std::set<std::string> names;
        for (const BlockView& block : reply.message.blocks) {
            if (block.name == "ray_splits") continue;
            columns.push_back(block);
            names.emplace(block.name);
            if (!has_known_type(block)) return daemon_sent("a column of a wrong type");
        }
        if (!std::ranges::includes(names, fields_) || (next_ != 0 && names != names_))
            return daemon_sent("other columns than were asked for, or than before");
        names_ = std::move(names);

        if (splits_) {
            const BlockView* splits = protocol::find_block(reply.message.blocks, "ray_splits");
            if (splits == nullptr || splits->dtype != wire::Dtype::u64 || splits->width() != 1 ||
                splits->count != chunk.count + std::uint64_t{1})
                return daemon_sent("hits without ray_splits");
            chunk.splits = splits->values<std::uint64_t>();
            if (chunk.splits.front() != 0 ||
                chunk.splits.back() > chunk.count * protocol::Limits{}.all_hits_max ||
                !std::is_sorted(chunk.splits.begin(), chunk.splits.end()))
                return daemon_sent("ray_splits that do not rise");
        } else {
            while (one_hit_each_.size() <= chunk.count)
                one_hit_each_.push_back(one_hit_each_.size());
            chunk.splits = std::span(one_hit_each_).first(chunk.count + std::size_t{1});
        }
        for (const BlockView& column : columns)
            if (column.count != (is_hit_field(column.name) ? chunk.splits.back() : chunk.count))
                return daemon_sent("a column of the wrong length");
        chunk.columns = columns;
        chunk.origin = outcome_.origin;
        chunk.hidden = outcome_.hidden;
        return consume_(chunk);
    }

    bool splits_;
    const Outcome& outcome_;  ///< filled by STARTED before the first chunk
    const std::function<Result<void>(const QueryChunk&)>& consume_;
    std::uint64_t next_ = 0;
    std::vector<std::uint64_t> one_hit_each_;  ///< 0, 1, 2, ...: the splits if each ray has one hit
    std::map<std::uint64_t, Reply<wire::Chunk>> waiting_;
    std::uint64_t waiting_bytes_ = 0;
    std::set<std::string> fields_;
    std::set<std::string> names_;  ///< columns of the chunk before
};

/// Returns the number of rows of the answer, or an upper bound while only the daemon knows it:
/// STARTED has the number of generated rays, and DONE the number of rows of a reduced answer.
std::uint64_t rows_of(const wire::QueryT& request, const RaySource& rays, const Outcome& outcome) {
    const ReducerWords* reducer = find_reducer(request.reduce);
    if (reducer != nullptr && reducer->rows == "found")
        return outcome.rows ? *outcome.rows : outcome.rays_announced;
    const bool made = request.generator != nullptr && request.reduce.empty();
    return made ? outcome.rays_announced : rays.count();
}

/// The bulk bytes of a frame of rays, with their masks.
std::uint64_t frame_bytes(const RaySource& rays, std::uint64_t count) {
    return protocol::padded(count * rays.ray_bytes()) +
           (rays.masks().empty() ? 0 : protocol::padded(count * sizeof(std::uint32_t)));
}

/// Returns the number of rays of the frame that begins at `first`.
std::uint64_t rays_of_frame(const Connection& connection, const RaySource& rays,
                            std::uint64_t first) {
    std::uint64_t room = connection.bulk_bytes_max();
    std::uint64_t each = rays.ray_bytes();
    if (!rays.masks().empty()) {
        room -= std::min(room, protocol::alignment);  // each block is padded
        each += sizeof(std::uint32_t);
    }
    return std::min({rays.count() - first, connection.daemon().chunk_rays_max,
                     std::max<std::uint64_t>(1, room / each)});
}

Result<void> send_rays(Connection& connection, const RaySource& rays, std::uint64_t first,
                       std::uint64_t count) {
    protocol::Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, rays.width(), count);
    wire::QueryRaysT message;
    message.first_ray = first;
    if (const auto& from = rays.common_origin())
        message.origin = std::make_unique<wire::Vec3>(*from);
    const bool masked = !rays.masks().empty();
    if (const auto ready = rays.bytes(first, count); !ready.empty() && !masked)
        return connection.send_bulk(std::move(message), std::move(bulk), ready);
    if (masked) bulk.add("masks", wire::Dtype::u32, 1, count);
    bulk.allocate();
    rays.read(first, bulk.block_as<float>(0));
    if (masked)
        std::ranges::copy(rays.masks().subspan(first, count),
                          bulk.block_as<std::uint32_t>(1).begin());
    return connection.send_bulk(std::move(message), std::move(bulk));
}

}  // namespace

Result<Outcome> run_query(Connection& connection, const wire::QueryT& request,
                          const RaySource& rays, Progress& progress,
                          const std::function<Result<void>(const QueryChunk&)>& consume,
                          std::span<const std::byte> trajectory) {
    const std::chrono::milliseconds deadline{request.job ? request.job->deadline_ms : 0};
    if (auto started = connection.start(request, deadline); !started)
        return tl::unexpected<Failure>(started.error());
    Outcome outcome;
    if (request.job) outcome.may_detach = request.job->detach;
    ChunkReorderer reorderer(has_splits(request.kind), outcome, consume, request.fields);
    std::uint64_t sent = 0;
    std::uint64_t uploaded = 0;
    while (true) {
        while (uploaded < trajectory.size()) {
            const std::uint64_t bytes =
                std::min<std::uint64_t>(trajectory.size() - uploaded, connection.bulk_bytes_max());
            if (connection.credit() < protocol::padded(bytes)) break;
            protocol::Bulk bulk;
            bulk.add("data", wire::Dtype::u8, 1, bytes);
            wire::UploadT piece;
            piece.offset = uploaded;
            if (auto done = connection.send_bulk(std::move(piece), std::move(bulk),
                                                 trajectory.subspan(uploaded, bytes));
                !done)
                return tl::unexpected<Failure>(done.error());
            uploaded += bytes;
        }
        while (sent < rays.count()) {
            const std::uint64_t count = rays_of_frame(connection, rays, sent);
            if (connection.credit() < frame_bytes(rays, count)) break;
            if (auto done = send_rays(connection, rays, sent, count); !done)
                return tl::unexpected<Failure>(done.error());
            sent += count;
        }
        auto frame = connection.next();
        if (!frame) return tl::unexpected<Failure>(frame.error());
        if (auto taken = take_news(*frame, outcome); !taken)
            return tl::unexpected<Failure>(taken.error());
        if (is<wire::Started>(*frame))
            if (auto same = check_origin(rays.scene_origin(), outcome.origin); !same)
                return tl::unexpected<Failure>(same.error());
        if (is<wire::Detached>(*frame)) return outcome;
        if (is<wire::Done>(*frame)) break;
        if (is<wire::Chunk>(*frame)) {
            const std::uint64_t rows = rows_of(request, rays, outcome);
            if (auto added = reorderer.add(std::move(*frame), rows); !added)
                return tl::unexpected<Failure>(added.error());
            if (request.reduce.empty()) progress.update(reorderer.answered(), rows, "tracing");
        }
        if (is<wire::Progress>(*frame) && !request.reduce.empty()) {
            const auto news = open_sent<wire::Progress>(*frame);
            if (!news) return tl::unexpected<Failure>(news.error());
            progress.update((*news)->done(), (*news)->total(), protocol::text((*news)->stage()));
        }
    }
    if (!outcome.has_started) return daemon_sent("the end of a request that had not started");
    if (reorderer.answered() != rows_of(request, rays, outcome))
        return daemon_sent("its last answer too early");
    return outcome;
}

std::function<Result<void>(const QueryChunk&)> with_columns(
    const SensorColumns& sensor, std::uint64_t first,
    const std::function<Result<void>(const QueryChunk&)>& consume) {
    return [&sensor, first, &consume](const QueryChunk& chunk) {
        return sensor.beside(chunk.columns, first + chunk.first_ray, chunk.count,
                             [&](std::span<const BlockView> columns) {
                                 QueryChunk more = chunk;
                                 more.columns = columns;
                                 return consume(more);
                             });
    };
}

Result<Outcome> fetch_query(Connection& connection, const wire::FetchT& request, Progress& progress,
                            const std::function<Result<void>(const QueryChunk&)>& consume) {
    if (auto started = connection.start(request); !started)
        return tl::unexpected<Failure>(started.error());
    Outcome outcome;
    std::optional<ChunkReorderer> reorderer;
    while (true) {
        auto frame = connection.next();
        if (!frame) return tl::unexpected<Failure>(frame.error());
        if (auto taken = take_news(*frame, outcome); !taken)
            return tl::unexpected<Failure>(taken.error());
        if (is<wire::Done>(*frame)) break;
        if (!is<wire::Chunk>(*frame)) continue;
        // The number of rays is known at the end; any chunk tells whether it is CSR.
        if (!reorderer) {
            const auto chunk = open_sent<wire::Chunk>(*frame);
            if (!chunk) return tl::unexpected<Failure>(chunk.error());
            const bool multi = protocol::find_block(chunk->blocks, "ray_splits") != nullptr;
            reorderer.emplace(multi, outcome, consume, std::vector<std::string>());
        }
        if (auto added = reorderer->add(std::move(*frame), protocol::Limits{}.rays_max); !added)
            return tl::unexpected<Failure>(added.error());
        progress.update(reorderer->answered(), 0, "fetching");
    }
    if (!outcome.has_started) return daemon_sent("the end of a request that had not started");
    if ((reorderer ? reorderer->answered() : 0) != outcome.rows)
        return daemon_sent("its last answer too early");
    return outcome;
}

}  // namespace raynest::client
