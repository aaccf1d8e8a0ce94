#include "server/jobs/chunked_job.h"

#include "server/ground/metrics.h"

#include <utility>

namespace raynest::server {

ChunkedJob::ChunkedJob(const Services& services, const Caller& caller, Plan plan,
                       std::uint64_t total, bool joins)
    : services_(services),
      principal_(caller.principal),
      id_(caller.request_id),
      plan_(std::move(plan)),
      queue_(plan_.backends, total, joins) {}

std::optional<Task> ChunkedJob::prepare() {
    if (!needs_preparation()) return std::nullopt;
    Task task;
    task.run = [this](const Stop& stop) -> Reply<Frames> {
        if (const auto ready = make_ready(stop); !ready) return tl::unexpected(ready.error());
        return Frames{};
    };
    return task;
}

std::optional<ChunkedJob::Work> ChunkedJob::next_work() {
    const auto chunk = queue_.next(
        [this](const Backend& backend, const Chunk& rest) { return chunk_size(backend, rest); });
    if (!chunk) return std::nullopt;
    Work work{*chunk, {}};
    work.task.pool = queue_.backend_of(*chunk).pool();
    work.task.run = [this, chunk = *chunk](const Stop& stop) { return run(chunk, stop); };
    return work;
}

void ChunkedJob::count_rays(std::string_view kind, const Chunk& chunk, std::uint64_t rays) {
    if (rays == 0) return;
    services_.metrics.count<&Metrics::rays>(principal_, rays);
    services_.metrics.rays_by_label.add(
        {kind, plan_.variant->name, queue_.backend_of(chunk).name()}, rays);
}

Reply<Frames> ChunkedJob::run(const Chunk& chunk, const Stop& stop) {
    statistics_.begin();
    const TraceBufferPool::Use buffers = services_.trace_buffers.take();
    auto answer = trace(chunk, stop, *buffers);
    if (answer) return std::move(*answer);
    if (auto* error = std::get_if<protocol::Error>(&answer.error()))
        return tl::unexpected(std::move(*error));
    const auto dealt = queue_.redeal(chunk, std::get<Unavailable>(answer.error()));
    if (!dealt) return tl::unexpected(dealt.error());
    return Frames{};
}

}  // namespace raynest::server
