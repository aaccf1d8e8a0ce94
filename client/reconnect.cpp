#include "client/reconnect.h"

#include "client/interrupt.h"
#include "client/scene_source.h"

#include <chrono>
#include <filesystem>
#include <ostream>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>

namespace raynest::client {
namespace {

using Clock = std::chrono::steady_clock;
using Seconds = std::chrono::duration<double>;

constexpr std::chrono::milliseconds pause{50};
/// Time for the old daemon's jobs to end, which the socket's holder waits for: drain_ms_max.
constexpr Seconds drain_time{30};

bool is_file(const std::string& path) {
    std::error_code ignored;
    return std::filesystem::is_regular_file(path, ignored);
}

/// True if the daemon finds or is sent the same scene again: not what came through a pipe.
bool is_lasting(const std::string& source) {
    return !is_source(source) || source.find(':') != std::string::npos || is_file(source);
}

bool is_job_safe(const JobOptions& job, const Failure& why) {
    // A detached job that was accepted runs on; only a refusal tells that none did.
    return is_lasting(job.scene) && (!job.detach || !is_own(why));
}

bool is_safe(const LoadOptions& load, const Failure& /*why*/) {
    return (load.source.find(':') != std::string::npos || is_file(load.source)) &&
           (load.instances.empty() || is_file(load.instances));
}
bool is_safe(const QueryOptions& query, const Failure& why) {
    return is_job_safe(query.job, why) && (query.rays_file.empty() || is_file(query.rays_file));
}
bool is_safe(const EditOptions& /*edit*/, const Failure& /*why*/) {
    return false;  // what has moved would move again
}
template <class Command>
bool is_safe(const Command& command, const Failure& why) {
    constexpr bool acts =
        std::is_same_v<Command, UnloadOptions> || std::is_same_v<Command, OpenOptions> ||
        std::is_same_v<Command, CancelOptions> || std::is_same_v<Command, LoadTestOptions> ||
        std::is_same_v<Command, LoginOptions> || std::is_same_v<Command, LogoutOptions> ||
        std::is_same_v<Command, AdminOptions>;
    if constexpr (requires { command.job.detach; })
        return is_job_safe(command.job, why);
    else if constexpr (requires { command.scene.size(); })
        return is_lasting(command.scene);
    else
        return !acts;
}

}  // namespace

Result<std::unique_ptr<Connection>> reconnect(const Connect& connect, double seconds,
                                              const Failure& why) {
    const Clock::time_point begin = Clock::now();
    while (true) {
        auto connection = connect();
        if (connection) return connection;
        const Failure& refused = connection.error();
        const bool waits = refused.lost || refused.exit == Exit::busy;
        if (!waits && refused.exit != Exit::cannot_connect) return connection;
        const bool drains = refused.lost && (refused.silent || !is_own(refused));
        const Seconds patience = Seconds(seconds) + (drains ? drain_time : Seconds(0));
        if (interrupted()) return fail(Exit::interrupted, "interrupted");
        if (Clock::now() - begin > patience) return tl::unexpected<Failure>(why);
        std::this_thread::sleep_for(pause);
    }
}

bool may_connect_again(const Failure& why) {
    return why.lost && !why.silent;
}

bool may_repeat(const CommandOptions& command, const Failure& why, bool printed) {
    if (!why.lost) return false;
    // Each look of `top` is complete by itself.
    if (printed && !std::holds_alternative<TopOptions>(command)) return false;
    return std::visit([&](const auto& options) { return is_safe(options, why); }, command);
}

PrintWatch::PrintWatch(std::ostream& stream) : stream_(stream), target_(stream.rdbuf()) {
    stream_.rdbuf(this);
}

PrintWatch::~PrintWatch() {
    stream_.rdbuf(target_);
}

PrintWatch::int_type PrintWatch::overflow(int_type c) {
    printed_ = true;
    return traits_type::eq_int_type(c, traits_type::eof())
               ? traits_type::not_eof(c)
               : target_->sputc(traits_type::to_char_type(c));
}

std::streamsize PrintWatch::xsputn(const char* text, std::streamsize size) {
    printed_ = true;
    return target_->sputn(text, size);
}

}  // namespace raynest::client
