// What becomes of an answer: rows on stdout, files, and the lines about them. The same whether the
// command that asked waited for it or fetch brought it later.
#pragma once

#include "client/commands/commands.h"
#include "client/picture.h"
#include "client/query.h"

#include <functional>
#include <string>
#include <vector>

namespace raynest::client {

Result<void> deliver_render(Context& context, const std::string& output, ReceivedPicture picture);
Result<void> deliver_heatmap(Context& context, const std::string& output, ReceivedPicture picture);

using ChunkConsumer = std::function<Result<void>(const QueryChunk&)>;
/// `ask` runs a query of `what`, a kind or a sum over rays, and passes its chunks on. Without an
/// `output` they become rows.
Result<void> deliver_query(Context& context, const std::string& output, const std::string& what,
                           const std::function<Result<Outcome>(const ChunkConsumer&)>& ask);

/// The number of a job that goes on without its client, alone on its line: job=$(raynest ...).
void print_detached(const Context& context, const Outcome& outcome);

}  // namespace raynest::client
