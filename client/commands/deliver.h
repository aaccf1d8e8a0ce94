// Delivers an answer: rows on stdout, files, and summaries. Used by the commands that wait for
// their answer, and by fetch.
#pragma once

#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/output/fail_if.h"
#include "client/requests/picture.h"
#include "client/requests/query.h"

#include <cstdint>
#include <functional>
#include <span>
#include <string>

namespace raynest::client {

/// Writes a rendered picture as it came, a raw one as .npy.
Result<void> write_picture(const std::string& output, const ReceivedFile& picture);

/// Delivers a rendered picture. `samples`: as many per pixel as were asked for; 0: unknown.
Result<void> deliver_render(Context& context, const std::string& output, ReceivedFile picture,
                            std::uint32_t samples = 0);
/// `checks` are what became of the limits of --fail-if; an exceeded one gives exit code 9.
Result<void> deliver_heatmap(Context& context, const std::string& output, ReceivedFile picture,
                             std::span<const Verdict> checks = {});

/// Prints the ranking of heatmap --top.
Result<void> deliver_ranking(Context& context, const ReceivedFile& answer);

using ChunkConsumer = std::function<Result<void>(const QueryChunk&)>;
/// Calls `ask`, which runs a query and passes its chunks on, and delivers them: to the file
/// `output`, or as rows if that is empty. `what` is the query's kind or reducer. `part` says which
/// part of which request it is, for a file that `raynest merge` reads; null: all of it.
Result<void> deliver_query(Context& context, const std::string& output, const std::string& what,
                           const std::function<Result<Outcome>(const ChunkConsumer&)>& ask,
                           const Json& part = {});

/// Has the daemon act, and prints its report.
Result<void> report_act(Context& context, const wire::AdminT& request);

/// Prints the number of a detached job, alone on its line: job=$(raynest ...).
void print_detached(const Context& context, const Outcome& outcome);

}  // namespace raynest::client
