// Checks that FlatBuffers' verifier does not make: 72.7 % of randomly damaged messages pass it.
//
// Lengths and characters of strings, lengths of lists, ranges and finiteness of numbers, lists that
// must be equally long. Handlers check the meaning of words.
#pragma once

#include "protocol/errors.h"
#include "protocol/limits.h"
#include "protocol/wire.h"

#include <string_view>

namespace raynest::protocol {

/// Well-formed UTF-8 without control characters: safe in logs, terminals and JSON.
[[nodiscard]] bool printable(std::string_view text);

// One overload per message of requests.def: `checked` ones are defined in validate.cpp, `plain`
// ones have nothing to check.
#define RAYNEST_VALIDATE_checked(Name) Result<void> validate(const wire::Name&, const Limits&);
#define RAYNEST_VALIDATE_plain(Name)                                 \
    inline Result<void> validate(const wire::Name&, const Limits&) { \
        return {};                                                   \
    }
#define RAYNEST_REQUEST(number, Name, handler, needs, role, repeat, checks, ...) \
    RAYNEST_VALIDATE_##checks(Name)
#define RAYNEST_PART(number, Name, checks, ...) RAYNEST_VALIDATE_##checks(Name)
#define RAYNEST_ANSWER(number, Name, checks) RAYNEST_VALIDATE_##checks(Name)
#include "protocol/lists/requests.def"
#undef RAYNEST_VALIDATE_checked
#undef RAYNEST_VALIDATE_plain

}  // namespace raynest::protocol
