// PAGE: answers with the page's address, and a code that begins one login of it as the caller.
#include "server/requests/request.h"
#include "server/security/page_logins.h"

#include <algorithm>
#include <cstdint>
#include <utility>

namespace raynest::server {

Reply<Answer> page(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Page>& /*message*/) {
    wire::PageAddressT address;
    if (services.page.empty() || services.page_logins == nullptr)
        return answer_with(caller, address, services);
    address.http = services.page;
    auto code = services.page_logins->make_code(caller.identity, WallClock::now());
    if (!code) return tl::unexpected(code.error());
    address.code = std::move(*code);
    address.code_ms = static_cast<std::uint32_t>(
        std::min<std::uint64_t>(services.limits.page_code_ms_max, UINT32_MAX));
    return answer_with(caller, address, services);
}

}  // namespace raynest::server
