// raynestd: one program for three kinds of process: the daemon, the short-lived import of one
// scene, and the device worker; and for the subcommands of commands.h.
#include "engine/assets/builtin/builtin.h"
#include "engine/assets/sandbox/import_child.h"
#include "server/backends/cuda/worker_process.h"
#include "server/daemon/commands.h"
#include "server/daemon/daemon.h"
#include "server/daemon/import_command.h"
#include "server/ground/journal.h"
#include "server/ground/log.h"
#include "server/options/options.h"

#include <malloc.h>

#include <cstdio>
#include <exception>
#include <iostream>
#include <sstream>
#include <utility>

namespace raynest::server {
namespace {

int run_import_child(int argc, const char* const* argv) {
    const auto registry = Registry::load({{argv + 3, argv + argc}, argv[2]});
    return registry ? import_child_main(**registry, describe_builtin) : 2;
}

/// Keeps memory of freed frames, up to some MiB each, in the heap. By default glibc returns the end
/// of a heap to the system after each and faults it in again: 1,200 page faults per million rays.
/// Blocks larger than `frame` are still mapped and unmapped one by one.
void keep_frames_in_heap() {
    constexpr int frame = 8 << 20;
    mallopt(M_MMAP_THRESHOLD, frame);
    mallopt(M_TRIM_THRESHOLD, 2 * frame);
}

int run(int argc, const char* const* argv) {
    if (argc >= 3 && argv[1] == import_child_flag) return run_import_child(argc, argv);
    if (argc == 3 && argv[1] == device::worker_flag) return device::run_worker_process(argv[2]);
    if (const auto code = run_command(argc, argv)) return *code;
    const ParsedOptions parsed = parse_options(argc, argv, std::cerr);
    if (!parsed.options) return parsed.exit_code;
    keep_frames_in_heap();
    set_log_level(parsed.options->log_level);
    set_log_format(parsed.options->log_format);
    return run_daemon(*parsed.options, [argc, argv]() -> Result<Options> {
        std::ostringstream unread;
        ParsedOptions again = parse_options(argc, argv, unread);
        if (again.options) return std::move(*again.options);
        return fail(ErrorCode::param_invalid, again.fault);
    });
}

}  // namespace
}  // namespace raynest::server

int main(int argc, char** argv) {
    try {
        return raynest::server::run(argc, argv);
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%sraynestd: %s\n",
                     raynest::server::journal_priority(raynest::server::LogLevel::error).data(),
                     error.what());
        return 1;
    }
}
