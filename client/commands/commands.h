// The subcommands of `raynest`, one file each. A command takes a struct of options, sends requests,
// prints text or JSON and writes files. To add one: declare its options in options.h and .cpp, and
// write a file here.
#pragma once

#include "client/commands/parse.h"
#include "client/ground/failure.h"
#include "client/ground/progress.h"
#include "client/net/connection.h"

#include <functional>
#include <memory>

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

Result<void> run(Context& context, const LoadOptions& options);
Result<void> run(Context& context, const ScenesOptions& options);
Result<void> run(Context& context, const InfoOptions& options);
Result<void> run(Context& context, const PathOptions& options);
Result<void> run(Context& context, const UnloadOptions& options);
Result<void> run(Context& context, const VariantsOptions& options);
Result<void> run(Context& context, const StatsOptions& options);
Result<void> run(Context& context, const RenderOptions& options);
Result<void> run(Context& context, const ResumeOptions& options);
Result<void> run(Context& context, const QueryOptions& options);
Result<void> run(Context& context, const HeatmapOptions& options);
Result<void> run(Context& context, const ExplainOptions& options);
Result<void> run(Context& context, const TopOptions& options);
Result<void> run(Context& context, const OpenOptions& options);
Result<void> run(Context& context, const JobsOptions& options);
Result<void> run(Context& context, const WaitOptions& options);
Result<void> run(Context& context, const FetchOptions& options);
Result<void> run(Context& context, const CancelOptions& options);
Result<void> run(Context& context, const LoadTestOptions& options);
Result<void> run(Context& context, const LoginOptions& options);
Result<void> run(Context& context, const LogoutOptions& options);
/// The same without a connection.
Result<void> log_out(const std::string& uri, bool json);
Result<void> run(Context& context, const AdminOptions& options);

/// Asks for the token of `raynest login` on the terminal, without showing it, or reads it from stdin.
Result<std::string> ask_token(const std::string& uri);

}  // namespace raynest::client
