#include "server/daemon/handover.h"

#include "server/daemon/constants.h"
#include "server/daemon/notify.h"
#include "server/ground/log.h"
#include "server/scheduling/admission.h"
#include "server/scheduling/fair_thread_pool.h"
#include "server/store/scene_store.h"

#include <fcntl.h>

#include <algorithm>
#include <string>
#include <utility>

namespace raynest::server {

Result<void> Handover::await_successor(int lock, Acts acts) {
    SuccessorSocket::Acts steps;
    steps.settle = [this](std::function<void()> settled) {
        asked_ = Clock::now();
        changes_.close();
        settle(asked_ + settle_time, std::move(settled));
    };
    steps.sockets = std::move(acts.sockets);
    steps.go_on = [this](std::function<void()> done) { go_on(std::move(done)); };
    steps.give_way = [this, give_way = std::move(acts.give_way)](pid_t successor) {
        const std::chrono::duration<double> seconds = Clock::now() - asked_;
        log(LogLevel::info, "handed_over",
            {{"to", std::to_string(successor)}, {"seconds", std::to_string(seconds.count())}});
        // The service manager believes the process that it knows.
        notify("MAINPID=" + std::to_string(successor));
        give_way();
    };
    auto opened = SuccessorSocket::open(io_, services_.state->path(), lock, std::move(steps));
    if (!opened) return tl::unexpected(opened.error());
    listening_ = std::move(*opened);
    return {};
}

void Handover::settle(Clock::time_point until, std::function<void()> settled) {
    const bool runs = std::ranges::any_of(services_.admission.jobs(), [](const auto& job) {
        return ChangeGate::concerns(job.second.kind);
    });
    if (runs && Clock::now() < until) {
        timer_.expires_after(drain_look);
        return timer_.async_wait(
            [this, until, settled = std::move(settled)](const SystemError& error) {
                if (!error) settle(until, settled);
            });
    }
    services_.state->note(services_.scenes.take_uses());
    services_.disk->submit("", Priority::high, [this, settled = std::move(settled)] {
        services_.state->close();
        asio::post(io_, settled);
    });
}

void Handover::go_on(std::function<void()> done) {
    services_.disk->submit("", Priority::high, [this, done = std::move(done)] {
        const auto opened = services_.state->reopen();
        asio::post(io_, [this, opened, done] {
            log(opened ? LogLevel::warn : LogLevel::error, "takeover_failed",
                {{"reason",
                  opened ? "the successor has ended before it served" : opened.error().message}});
            changes_.open([this](std::function<void()> next) { asio::post(io_, std::move(next)); });
            done();
        });
    });
}

void Handover::serve_after(Predecessor predecessor) {
    predecessor_ = std::move(predecessor);
    predecessor_->serving();
    log(LogLevel::info, "took_over", {{"from", std::to_string(predecessor_->pid())}});
    predecessor_ends_.assign(fcntl(predecessor_->descriptor(), F_DUPFD_CLOEXEC, 0));
    predecessor_ends_.async_wait(predecessor_ends_.wait_read, [this](const SystemError& error) {
        if (error) return;
        log(LogLevel::info, "predecessor_ended", {{"pid", std::to_string(predecessor_->pid())}});
        predecessor_ends_.close();
        services_.disk->submit("", Priority::low, [this] { services_.state->remove_leftovers(); });
    });
}

}  // namespace raynest::server
