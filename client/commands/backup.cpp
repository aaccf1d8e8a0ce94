// raynest backup FILE: all stored scenes of the daemon as one tar file.
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/output/outcome_text.h"
#include "client/output/output.h"
#include "client/output/output_file.h"
#include "client/requests/picture.h"

#include <sys/stat.h>

#include <filesystem>
#include <system_error>

namespace raynest::client {
namespace {

/// A copy of all stored scenes, and the way back.
struct BackupOptions {
    std::string output;
};

}  // namespace

void declare(CommandLine& line, BackupOptions& options) {
    line.add_option(
            "FILE", options.output,
            "a tar file for the scenes of all owners, with their kept edits, as they are at "
            "one moment; - is stdout. A file of that name is replaced once the new one is "
            "whole and on the disk. raynest restore brings them back")
        .required();
}

Result<void> run(Context& context, const BackupOptions& options) {
    if (auto writable = check_writable(options.output); !writable) return writable;
    if (auto started = context.connection.start(wire::BackupT{}); !started)
        return tl::unexpected<Failure>(started.error());
    // Names, owners and shares are not for others to read.
    auto file = OutputFile::open(options.output, S_IRUSR | S_IWUSR);
    if (!file) return tl::unexpected<Failure>(file.error());
    Outcome outcome;
    const auto bytes =
        receive_bytes(context.connection, context.progress, outcome,
                      [&](std::span<const std::byte> piece) { return file->write(piece); });
    context.progress.clear();
    if (!bytes) return tl::unexpected<Failure>(bytes.error());
    if (auto finished = file->finish_on_disk(); !finished) return finished;
    print_notes(outcome);
    if (context.json)
        print_json(Json{{"file", options.output}, {"bytes", *bytes}, {"notes", outcome.notes}});
    else
        summary_of(options.output) << options.output << ": " << *bytes << " bytes\n";
    return {};
}

namespace {

class Backup final : public CommandOf<BackupOptions> {
    /// What went into a pipe cannot be taken back.
    [[nodiscard]] bool is_safe(const Failure& /*why*/) const override {
        std::error_code ignored;
        return !is_stdout(options_.output) &&
               (!std::filesystem::exists(options_.output, ignored) || is_file(options_.output));
    }
};

}  // namespace

std::unique_ptr<Command> make_backup() {
    return std::make_unique<Backup>();
}

}  // namespace raynest::client
