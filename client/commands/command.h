// A command of `raynest`. Each has a row in commands.def and a file of its own: a struct of
// options, declare(), which adds them to the command line, run(), which sends requests, prints text
// or JSON and writes files, and make_NAME(), which the program calls.
#pragma once

#include "client/arguments/command_line.h"
#include "client/ground/failure.h"
#include "client/ground/progress.h"
#include "client/net/access.h"
#include "client/net/connection.h"
#include "client/requests/request_options.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

namespace raynest::client {

struct Context {
    Connection& connection;
    Progress& progress;
    bool json = false;
    /// Opens another connection to the same daemon.
    std::function<Result<std::unique_ptr<Connection>>()> connect;
    const std::string& uri;
    const Access& access;
};

/// Where the daemon is of a command that the Python package carries out.
struct DaemonPlace {
    std::string uri;
    const Access& access;
    std::string folder;  ///< a daemon's for this command alone: removed once it is reached
    double reconnect = 0;
    bool json = false;
    std::string dask{};  ///< a scheduler's address, in place of a daemon's
    bool quiet = false;
};

/// The work that --dask divides.
struct Parts {
    std::uint64_t most = 1;  ///< each with 50 ms of work or more
    std::string output;
    bool is_one = false;  ///< it is a part already
};
/// Rays that make 50 ms of work.
inline constexpr std::uint64_t part_rays = 1 << 16;
[[nodiscard]] Parts picture_parts(const PictureOptions& picture, std::uint64_t samples);

/// A command with its options, as the program sees it. Each overrides what it has beside the
/// others.
class Command {
public:
    Command() = default;
    virtual ~Command() = default;
    Command(const Command&) = delete;

    virtual void declare_options(CommandLine& line) = 0;
    virtual Result<void> carry_out(Context& context) const = 0;

    /// The scene that it is for, or a source in its place; null where it is for none.
    [[nodiscard]] virtual std::string* scene() = 0;
    /// Null where it asks for none.
    [[nodiscard]] virtual JobOptions* job() = 0;
    /// True if it does the same when it runs again after `why`: what it loads can be read once
    /// more.
    [[nodiscard]] virtual bool is_safe(const Failure& why) const = 0;
    /// True if each part of what it prints is complete by itself.
    [[nodiscard]] virtual bool prints_looks() const { return false; }

    /// The daemon that it names; null: that of --server.
    [[nodiscard]] virtual const std::string* uri() const { return nullptr; }
    /// Does all of it without a daemon; nothing where it needs one.
    virtual std::optional<Result<void>> run_alone(const std::string& /*uri*/, bool /*json*/) const {
        return std::nullopt;
    }
    /// Completes what the daemon is told of the user.
    virtual Result<void> identify(const std::string& /*uri*/, Access& /*access*/) const {
        return {};
    }
    /// True if it is for a daemon that goes on after it.
    [[nodiscard]] virtual bool needs_lasting_daemon() const { return false; }
    /// A scene that it compares with; null where there is none.
    [[nodiscard]] virtual const std::string* other_scene() const { return nullptr; }
    /// The work that --dask divides; nothing where it divides none.
    [[nodiscard]] virtual std::optional<Parts> parts() const { return std::nullopt; }
    /// True if the Python package carries it out. Fails where an option does not go with that.
    [[nodiscard]] virtual Result<bool> is_by_python() const { return false; }
    /// Makes this process the Python program that does so. Returns only where that fails.
    [[nodiscard]] virtual Failure become_program(const DaemonPlace& /*place*/) const {
        return failure(Exit::failed, "the command line carries it out");
    }
    /// Tells the words of the command line, as a shell takes them.
    virtual void told(const std::string& /*words*/) {}
};

/// True if a source can be read again: not what came through a pipe.
[[nodiscard]] bool is_lasting(const std::string& source);
[[nodiscard]] bool is_file(const std::string& path);
[[nodiscard]] bool is_job_safe(const JobOptions& job, const Failure& why);

/// A command whose file has declare() and run() for its options.
template <class Options>
class CommandOf : public Command {
public:
    [[nodiscard]] const Options& options() const { return options_; }

    void declare_options(CommandLine& line) override { declare(line, options_); }
    Result<void> carry_out(Context& context) const override { return run(context, options_); }

    [[nodiscard]] std::string* scene() override {
        if constexpr (has_job)
            return &options_.job.scene;
        else if constexpr (has_scene)
            return &options_.scene;
        else
            return nullptr;
    }
    [[nodiscard]] JobOptions* job() override {
        if constexpr (has_job)
            return &options_.job;
        else
            return nullptr;
    }
    [[nodiscard]] bool is_safe(const Failure& why) const override {
        if constexpr (has_job)
            return is_job_safe(options_.job, why);
        else if constexpr (has_scene)
            return is_lasting(options_.scene);
        else
            return true;
    }

protected:
    static constexpr bool has_job = requires(Options options) { options.job.detach; };
    static constexpr bool has_scene = requires(Options options) { options.scene.size(); };

    Options options_;
};

template <class Options>
std::unique_ptr<Command> make_command() {
    return std::make_unique<CommandOf<Options>>();
}

#define RAYNEST_COMMAND(name, ...) std::unique_ptr<Command> make_##name();
#include "client/commands/commands.def"

/// True if a command may run once more after `why`, the loss of its daemon. `acts`: its request
/// does more when it is sent twice; `printed`: a part of its answer is on stdout.
[[nodiscard]] bool may_repeat(const Command& command, bool acts, const Failure& why, bool printed);

}  // namespace raynest::client
