#include "server/requests/words/explain_request.h"

#include "server/jobs/payload_sender.h"
#include "server/scheduling/peers.h"

#include <string>
#include <utility>

namespace raynest::server {
namespace {

/// Bytes of an entry of a document, at most: in memory and as text, with names and a path.
constexpr std::uint64_t explained_entry_bytes = 3 * 1024;
/// Bytes of a document but for its entries, at most.
constexpr std::uint64_t explained_head_bytes = 64 * 1024;

}  // namespace

Reply<Budget::Lease> reserve_explanation(const Services& services, const Caller& caller,
                                         std::uint64_t entries, std::string_view fewer) {
    const std::uint64_t bytes = explained_head_bytes + entries * explained_entry_bytes;
    auto lease = services.peers.reserve(bytes, caller.principal);
    if (lease) return std::move(*lease);
    return services.budget.refuse("the explanation", bytes, caller.principal, std::string(fewer));
}

JobSubmission accept_explanation(const Caller& caller, const Plan& plan, std::uint64_t bytes,
                                 std::string_view fewer) {
    JobSubmission accepted = accept(plan, "explain", 1);
    accepted.advice = fewer;
    accepted.answer_bytes = accepted.result_bytes = payload_answer_bytes(caller, bytes);
    return accepted;
}

Reply<void> check_pixel(const Pixel& pixel, std::uint32_t width, std::uint32_t height) {
    if (pixel[0] < width && pixel[1] < height) return {};
    return refuse(Code::invalid_field,
                  "pixel " + std::to_string(pixel[0]) + "," + std::to_string(pixel[1]) +
                      " lies outside of a picture of " + std::to_string(width) + "x" +
                      std::to_string(height) + "; pixels count from 0,0, the upper left corner");
}

}  // namespace raynest::server
