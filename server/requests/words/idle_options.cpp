#include "server/requests/words/idle_options.h"
#include "protocol/text.h"

#include <algorithm>
#include <array>

namespace raynest::server {
namespace {

using namespace std::string_view_literals;

/// An option that a request may have, and the integrators that use it.
struct Option {
    std::string_view name;
    bool (*is_given)(const wire::Render&);
    std::array<std::string_view, 3> users;
};

bool has_environment(const wire::Render& message) {
    return protocol::word(message.environment(), "auto") != "auto";
}
bool has_exposure(const wire::Render& message) {
    return !protocol::text(message.exposure()).empty();
}
bool has_tonemap(const wire::Render& message) {
    return !protocol::text(message.tonemap()).empty();
}

constexpr std::array options = {
    Option{"depth", [](const wire::Render& m) { return m.depth() != 0; }, {"path"sv}},
    Option{"ao_distance", [](const wire::Render& m) { return m.ao_distance() != 0; }, {"ao"sv}},
    Option{"environment", has_environment, {"direct"sv, "path"sv}},
    Option{"environment_rotate", [](const wire::Render& m) { return m.environment_rotate() != 0; },
           {"direct"sv, "path"sv}},
    Option{"sun", [](const wire::Render& m) { return m.sun(); }, {"direct"sv, "path"sv}},
    Option{"noise", [](const wire::Render& m) { return m.noise() != 0; },
           {"ao"sv, "direct"sv, "path"sv}},
    Option{"tonemap", has_tonemap, {"ao"sv, "direct"sv, "path"sv}},
    Option{"exposure", has_exposure, {"ao"sv, "direct"sv, "path"sv}},
};

void add(std::string& list, std::string_view name) {
    list.append(list.empty() ? "`" : ", `").append(name).append("`");
}

}  // namespace

std::string idle_options_note(const wire::Render& message, std::string_view integrator) {
    // A picture that is continued repeats all options of the one before.
    if (message.resume_bytes() != 0) return {};
    const bool linear = protocol::word(message.encode(), "png") == "exr";
    std::string by_integrator, by_file;
    for (const Option& option : options) {
        if (!option.is_given(message)) continue;
        if (std::ranges::find(option.users, integrator) == option.users.end())
            add(by_integrator, option.name);
        else if (linear && (option.name == "tonemap" || option.name == "exposure"))
            add(by_file, option.name);
    }
    std::string note;
    if (!by_integrator.empty())
        note = "no effect with integrator " + std::string(integrator) + ": " + by_integrator;
    if (!by_file.empty())
        note += (note.empty() ? "" : "; ") + ("no effect on an EXR, which is linear: " + by_file);
    return note;
}

}  // namespace raynest::server
