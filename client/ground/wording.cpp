#include "client/ground/wording.h"

#include <algorithm>
#include <array>

namespace raynest::client {
namespace {

struct Word {
    std::string_view protocol;
    std::string_view own;
};
constexpr std::array words = {
#define RAYNEST_WORD(protocol, own, python) Word{#protocol, own},
#include "client/ground/wording.def"
#define RAYNEST_INTEGRATOR_SETTING(name, type, option, ...) Word{#name, option},
#include "engine/integrators/integrator_settings.def"
};

}  // namespace

std::string localize_message(std::string_view message) {
    std::string own;
    while (true) {
        const std::size_t begin = message.find('`');
        own += message.substr(0, begin);
        if (begin == std::string_view::npos) return own;
        const std::string_view rest = message.substr(begin + 1);
        const auto* const word =
            std::ranges::find(words, rest.substr(0, rest.find('`')), &Word::protocol);
        if (word == words.end()) {
            own += '`';
            message = rest;
        } else {
            own += word->own;
            message = rest.substr(word->protocol.size() + 1);
        }
    }
}

}  // namespace raynest::client
