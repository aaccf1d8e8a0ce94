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
    // requests
    Word{"CancelJob", "raynest cancel"},
    Word{"Edit", "raynest edit"},
    Word{"Export", "raynest export"},
    Word{"Fetch", "raynest fetch"},
    Word{"Info", "raynest info"},
    Word{"Jobs", "raynest jobs"},
    Word{"Load", "raynest load"},
    Word{"Pin", "raynest pin"},
    Word{"Scenes", "raynest scenes"},
    Word{"Unload", "raynest unload"},
    Word{"Variants", "raynest variants"},
    Word{"Wait", "raynest wait"},
    // fields
    Word{"animation", "--animation"},
    Word{"ao_distance", "--ao-distance"},
    Word{"camera", "--camera"},
    Word{"count", "--count"},
    Word{"deadline_ms", "--deadline"},
    Word{"depth", "--depth"},
    Word{"detach", "--detach"},
    Word{"environment", "--env"},
    Word{"environment_rotate", "--env-rotate"},
    Word{"epoch", "--epoch"},
    Word{"exposure", "--exposure"},
    Word{"hide", "--hide"},
    Word{"keep", "--keep"},
    Word{"level", "--level"},
    Word{"look_at", "--lookat"},
    Word{"mask", "--mask"},
    Word{"name", "--name"},
    Word{"noise", "--noise"},
    Word{"only", "--only"},
    Word{"origin", "--origin"},
    Word{"palette", "--palette"},
    Word{"primitive", "--primitive"},
    Word{"progressive", "--progressive"},
    Word{"radius", "--radius"},
    Word{"replace", "--replace"},
    Word{"samples", "--spp"},
    Word{"scale", "--scale"},
    Word{"seed", "--seed"},
    Word{"size", "--size"},
    Word{"skip_hidden_boxes", "--skip-hidden-boxes"},
    Word{"spacing", "--spacing"},
    Word{"sun", "--sun"},
    Word{"time", "--time"},
    Word{"tonemap", "--tonemap"},
    Word{"top", "--top"},
    Word{"traversal", "--traversal"},
    Word{"unit", "--unit"},
    Word{"up", "--up"},
    Word{"variant", "--variant"},
    Word{"worker", "--worker"},
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
