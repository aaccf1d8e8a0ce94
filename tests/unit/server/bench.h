// Runs a daemon's jobs without sockets: a runner, a sink in memory, scripted jobs.
#pragma once

#include "protocol/control.h"
#include "server/scheduling/runner.h"
#include "tests/patience.h"

#include <condition_variable>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

namespace raynest::server {

inline protocol::Limits few_jobs() {
    protocol::Limits limits;
    limits.total_jobs_max = 5;  // 4 of one principal
    return limits;
}

/// Replaces the io thread: completions wait in a queue until the test takes them.
class Bench final : public Sink {
public:
    Bench() { runner->set_window(window); }
    ~Bench() { runner->abandon(); }

    void send(protocol::Frame frame) override { sent.push_back(std::move(frame)); }
    [[nodiscard]] std::uint64_t backlog() const override { return waiting; }

    /// Takes completions until `done` holds; false if none comes while patience lasts.
    template <class Condition>
    bool run_until(Condition done) {
        while (!done()) {
            std::unique_lock lock(mutex_);
            if (!wake_.wait_for(lock, test::patience(), [&] { return !posted_.empty(); }))
                return false;
            const std::function<void()> next = std::move(posted_.front());
            posted_.pop_front();
            lock.unlock();
            next();
        }
        return true;
    }
    /// Runs what waits for `by_hand`, which has no threads, and takes completions, until neither is
    /// left.
    void settle(FairThreadPool& by_hand) {
        do {
            for (;;) {
                std::unique_lock lock(mutex_);
                if (posted_.empty()) break;
                const std::function<void()> next = std::move(posted_.front());
                posted_.pop_front();
                lock.unlock();
                next();
            }
        } while (by_hand.run_one());
    }
    /// This bench's context, but for what computes.
    [[nodiscard]] JobContext engine_with(FairThreadPool& compute) const {
        return {compute,       engine.admission,     engine.metrics,   engine.limits, engine.post,
                engine.budget, engine.inline_budget, engine.coalescer, engine.peers};
    }
    bool run_until_idle() {
        return run_until([&] { return runner->size() == 0 && admission.active() == 0; });
    }
    [[nodiscard]] std::size_t count(wire::Message type) const {
        std::size_t n = 0;
        for (const auto& frame : sent) n += frame.header.type == static_cast<std::uint16_t>(type);
        return n;
    }
    [[nodiscard]] std::optional<Code> error() const {
        for (const auto& frame : sent)
            if (const auto message = protocol::open<wire::Error>(frame))
                return static_cast<Code>((*message)->code());
        return std::nullopt;
    }

    static constexpr std::uint64_t window = 1 << 20;
    protocol::Limits limits = few_jobs();
    Metrics metrics;
    Admission admission{limits};
    Budget budget{1ULL << 30};
    Peers peers{limits, budget, metrics};
    InlineBudget inline_budget;
    Coalescer coalescer;
    std::uint64_t waiting = 0;
    std::vector<protocol::Frame> sent;

private:
    std::mutex mutex_;
    std::condition_variable wake_;
    std::deque<std::function<void()>> posted_;
    FairThreadPool compute_{2};

public:
    JobContext engine{compute_,
                      admission,
                      metrics,
                      limits,
                      [this](std::function<void()> done) {
                          const std::lock_guard lock(mutex_);
                          posted_.push_back(std::move(done));
                          wake_.notify_all();
                      },
                      budget,
                      inline_budget,
                      coalescer,
                      peers};
    std::shared_ptr<Runner> runner = std::make_shared<Runner>(engine, *this, "me");
};

inline protocol::Frame chunk_of(std::uint64_t bytes) {
    protocol::Bulk bulk;
    bulk.add("data", wire::Dtype::u8, 1, bytes);
    bulk.allocate();
    return protocol::encode(1, wire::ChunkT{}, std::move(bulk)).value();
}

/// A job of `tasks` tasks that answer `bytes` each; `work` runs before each answer.
class ScriptedJob final : public Job {
public:
    ScriptedJob(std::size_t tasks, std::uint64_t bytes,
                std::function<Reply<void>(const Stop&)> work = {})
        : tasks_(tasks),
          bytes_(bytes),
          work_(std::move(work)) {}

    std::optional<Task> next() override {
        if (given_ == tasks_) return std::nullopt;
        ++given_;
        Task task;
        task.reply_bytes_max = protocol::padded(bytes_);
        task.run = [this](const Stop& stop) -> Reply<Frames> {
            if (work_)
                if (const auto worked = work_(stop); !worked) return tl::unexpected(worked.error());
            Frames frames;
            frames.push_back(chunk_of(bytes_));
            return frames;
        };
        return task;
    }
    [[nodiscard]] bool finished() const override { return given_ == tasks_; }
    Frames farewell() override {
        Frames frames;
        frames.push_back(*protocol::encode(1, wire::DoneT{}));
        return frames;
    }

private:
    const std::size_t tasks_;
    const std::uint64_t bytes_;
    const std::function<Reply<void>(const Stop&)> work_;
    std::size_t given_ = 0;
};

inline JobSubmission accept(std::unique_ptr<Job> job, std::uint32_t deadline_ms = 0) {
    JobSubmission accepted;
    accepted.job = std::move(job);
    accepted.deadline_ms = deadline_ms;
    return accepted;
}

}  // namespace raynest::server
