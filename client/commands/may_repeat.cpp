#include "client/commands/may_repeat.h"

#include "client/output/output_file.h"
#include "client/requests/scene_source.h"

#include <filesystem>
#include <string>
#include <type_traits>
#include <variant>

namespace raynest::client {
namespace {

// The column `repeat` of the commands: true if a second run does more than the first.
namespace acts {
constexpr bool again = false, once = true;
#define RAYNEST_REQUEST(number, Name, handler, needs, role, repeat, ...) \
    constexpr bool Name = repeat;
#include "protocol/lists/requests.def"
}  // namespace acts

/// Has no default: a command says it in its row.
template <class Command>
struct Acts;
#define RAYNEST_COMMAND(Name, word, repeat, ...) \
    template <>                                  \
    struct Acts<Name##Options> : std::bool_constant<acts::repeat> {};
#include "client/commands/commands.def"

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
    return is_job_safe(query.job, why) && (query.rays_file.empty() || is_file(query.rays_file)) &&
           (query.masks_file.empty() || is_file(query.masks_file));
}
/// What went into a pipe cannot be taken back.
bool is_safe(const BackupOptions& backup, const Failure& /*why*/) {
    std::error_code ignored;
    return !is_stdout(backup.output) &&
           (!std::filesystem::exists(backup.output, ignored) || is_file(backup.output));
}
template <class Command>
bool is_safe(const Command& command, const Failure& why) {
    if constexpr (requires { command.job.detach; })
        return is_job_safe(command.job, why);
    else if constexpr (requires { command.scene.size(); })
        return is_lasting(command.scene);
    else
        return true;
}

}  // namespace

bool may_repeat(const CommandOptions& command, const Failure& why, bool printed) {
    if (!why.lost) return false;
    // Each look of `top` is complete by itself.
    if (printed && !std::holds_alternative<TopOptions>(command)) return false;
    return std::visit(
        [&]<class Command>(const Command& options) {
            return !Acts<Command>::value && is_safe(options, why);
        },
        command);
}

}  // namespace raynest::client
