#include "server/backends/cuda/process.h"

#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <system_error>
#include <thread>

namespace raynest::server::device {
namespace {

/// Number of looks, 1 s in all, to wait for the end of a process that was killed or hung up.
constexpr int polls_max = 200;
constexpr std::chrono::milliseconds exit_poll_interval{5};
constexpr std::chrono::milliseconds stop_look{50};

/// Waits on a thread of its own for a killed process that its driver keeps from ending. If no
/// thread can be started, the process stays a zombie.
void wait_elsewhere(pid_t pid) noexcept {
    try {
        std::thread([pid] { ::waitpid(pid, nullptr, 0); }).detach();
    } catch (const std::system_error&) {
    }
}

}  // namespace

Result<std::shared_ptr<Process>> Process::start(const Setup& setup) {
    std::shared_ptr<Process> process(new Process(setup.shape));
    if (const auto shared = process->share_memory(setup); !shared)
        return tl::unexpected(shared.error());
    auto control = Channel::make_pair();
    if (!control) return tl::unexpected(control.error());
    const auto pid = spawn_child(setup.command, std::array{control->second.get()});
    if (!pid) return tl::unexpected(pid.error());
    process->pid_ = *pid;
    {
        // Close this process's copy of the child's end: the child's exit then closes the channel.
        const Channel theirs = std::move(control->second);
    }
    if (const auto greeted = process->greet(setup, std::move(control->first)); !greeted)
        return tl::unexpected(greeted.error());
    // Reserve only after the greeting: without a device the slots take no memory.
    if (const auto reserved = process->reserve(setup); !reserved)
        return tl::unexpected(reserved.error());
    return process;
}

Result<void> Process::reserve(const Setup& setup) {
    const std::uint64_t bytes = setup.slots * shape_.bytes();
    if (bytes > slots_share(setup.budget->limit()))
        return fail(ErrorCode::pack_invalid, "a call takes " + std::to_string(bytes) +
                                                 " bytes, more than a quarter of raynestd's "
                                                 "--memory; give the daemon four times that");
    auto lease = setup.budget->reserve(bytes);
    if (!lease)
        return fail(ErrorCode::limit_exceeded, "its slots need " + std::to_string(bytes) +
                                                   " bytes, more than --memory has left");
    lease_ = std::move(*lease);
    return {};
}

Result<void> Process::share_memory(const Setup& setup) {
    auto file = create_memory_file("raynest-device-slots");
    if (!file) return tl::unexpected(file.error());
    memory_file_ = std::move(*file);
    if (::ftruncate(memory_file_.get(), static_cast<off_t>(setup.slots * shape_.bytes())) == 0)
        memory_ = Mapping(memory_file_, Mapping::Access::share);
    if (!memory_.bytes().empty()) return {};
    return fail(ErrorCode::io_failed,
                std::string("no memory for the device's slots: ") + std::strerror(errno));
}

Result<void> Process::greet(const Setup& setup, Channel control) {
    const auto ended = [&] {
        return fail(ErrorCode::io_failed, "the worker " + reap() + " while it started");
    };
    std::vector<Channel> theirs;
    std::vector<int> files = {memory_file_.get()};
    for (std::uint32_t i = 0; i < setup.slots; ++i) {
        auto pair = Channel::make_pair();
        if (!pair) return tl::unexpected(pair.error());
        slots_.push_back(std::move(pair->first));
        theirs.push_back(std::move(pair->second));
        files.push_back(theirs.back().get());
    }
    if (!control.send(Hello{::getpid(), setup.slots, shape_}, files)) return ended();
    ready_ = std::make_unique<Ready>();
    const auto deadline = std::chrono::steady_clock::now() + setup.time_limit;
    Received received = Received::nothing_in_time;
    while (received == Received::nothing_in_time && !*setup.stop &&
           std::chrono::steady_clock::now() < deadline)
        received = control.receive(*ready_, stop_look);
    switch (received) {
        case Received::message:
            break;
        case Received::closed:
            return ended();
        case Received::nothing_in_time:
            return fail(ErrorCode::io_failed, "the worker did not start within " +
                                                  std::to_string(setup.time_limit.count()) + " ms");
    }
    if (!ready_->ok)
        return fail(ready_->absent ? ErrorCode::pack_invalid : ErrorCode::io_failed,
                    ready_->text.printable());
    control_ = std::move(control);
    return {};
}

Result<Outcome> Process::ask(std::uint32_t slot, const Request& request,
                             std::chrono::milliseconds time_limit, std::span<const int> files) {
    Channel& channel = slots_[slot];
    Outcome outcome;
    if (!channel.send(request, files)) return fail(ErrorCode::io_failed, "the worker " + reap());
    switch (channel.receive(outcome, time_limit)) {
        case Received::message:
            return outcome;
        case Received::nothing_in_time:
            return fail(ErrorCode::io_failed,
                        "no answer within " + std::to_string(time_limit.count()) + " ms");
        case Received::closed:
            break;
    }
    return fail(ErrorCode::io_failed, "the worker " + reap());
}

void Process::kill() {
    if (pid_ > 0) ::kill(pid_, SIGKILL);
}

std::optional<std::string> Process::end() const {
    siginfo_t info{};
    // Leave the process waitable (WNOWAIT): the destructor reaps it.
    if (::waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOWAIT | WNOHANG) != 0)
        return "went away";
    if (info.si_pid == 0) return std::nullopt;
    if (info.si_code == CLD_EXITED) return "ended with exit code " + std::to_string(info.si_status);
    return std::string("was ended by a signal (") + ::strsignal(info.si_status) + ")";
}

std::string Process::reap() const {
    for (int i = 0; i < polls_max; ++i) {
        if (auto ended = end()) return *ended;
        std::this_thread::sleep_for(exit_poll_interval);
    }
    return "went away";
}

Process::~Process() {
    if (pid_ <= 0) return;
    kill();
    int looks = 0;
    while (looks < polls_max && ::waitpid(pid_, nullptr, WNOHANG) == 0) {
        std::this_thread::sleep_for(exit_poll_interval);
        ++looks;
    }
    if (looks == polls_max) wait_elsewhere(pid_);
}

}  // namespace raynest::server::device
