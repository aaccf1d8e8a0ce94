// Checks of the messages of administrators and of the page's login (validate.h).
#include "protocol/checks.h"
#include "protocol/validate.h"

namespace raynest::protocol {

Result<void> validate(const wire::Admin& message, const Limits& limits) {
    return Checks(limits)
        .named("act", message.act())
        .name("principal", message.principal())
        .settings("quota", message.quota(), limits.name_bytes_max, "name_bytes_max")
        .result();
}

Result<void> validate(const wire::Restore& message, const Limits& limits) {
    return Checks(limits).texts("scenes", message.scenes()).result();
}

Result<void> validate(const wire::AdminReport& message, const Limits& limits) {
    return Checks(limits)
        .text("text", message.text())
        .names("principals", message.principals())
        .names("roles", message.roles())
        .names("transports", message.transports())
        .names("peers", message.peers())
        .numbers("connections", message.principals(), message.connections())
        .numbers("age_ms", message.principals(), message.age_ms())
        .numbers("jobs", message.principals(), message.jobs())
        .result();
}

Result<void> validate(const wire::PageAddress& message, const Limits& limits) {
    return Checks(limits).name("http", message.http()).name("code", message.code()).result();
}

}  // namespace raynest::protocol
