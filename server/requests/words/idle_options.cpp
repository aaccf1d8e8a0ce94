#include "server/requests/words/idle_options.h"

#include "protocol/text.h"

#include <algorithm>
#include <array>

namespace raynest::server {
namespace {

using namespace std::string_view_literals;
using wire::Render;

/// An option that a request may have, and the integrators that use it.
struct Option {
    std::string_view name;
    bool (*is_given)(const Render&);
    std::array<std::string_view, 3> users;
};

constexpr std::array all_lit = {"ao"sv, "direct"sv, "path"sv};
constexpr std::array<std::string_view, 3> by_light = {"direct"sv, "path"sv};

constexpr std::array options = {
    Option{"samples", [](const Render& m) { return m.samples() > 1; }, all_lit},
    Option{"seed", [](const Render& m) { return m.seed() != 0; }, all_lit},
    Option{"depth", [](const Render& m) { return m.depth() != 0; }, {"path"sv}},
    Option{"ao_distance", [](const Render& m) { return m.ao_distance() != 0; }, {"ao"sv}},
    Option{"environment",
           [](const Render& m) { return protocol::word(m.environment(), "auto") != "auto"; },
           by_light},
    Option{"environment_rotate", [](const Render& m) { return m.environment_rotate() != 0; },
           by_light},
    Option{"sun", [](const Render& m) { return m.sun(); }, by_light},
    Option{"noise", [](const Render& m) { return m.noise() != 0; }, all_lit},
    Option{"tonemap", [](const Render& m) { return !protocol::text(m.tonemap()).empty(); },
           all_lit},
    Option{"exposure", [](const Render& m) { return !protocol::text(m.exposure()).empty(); },
           all_lit},
    Option{"progressive", [](const Render& m) { return m.progressive(); }, all_lit},
};

void add(std::string& list, std::string_view name) {
    list.append(list.empty() ? "`" : ", `").append(name).append("`");
}

/// "" where the list is empty.
std::string note_of(std::string_view where, const std::string& list) {
    return list.empty() ? "" : "no effect " + std::string(where) + ": " + list;
}

}  // namespace

std::string idle_options_note(const Render& message, std::string_view integrator) {
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
    std::string note = note_of("with integrator " + std::string(integrator), by_integrator);
    if (!by_file.empty())
        note.append(note.empty() ? "" : "; ")
            .append(note_of("on an EXR, which is linear", by_file));
    return note;
}

std::string idle_options_note(const wire::Heatmap& message, std::string_view file) {
    if (file == "png") return {};
    std::string colours;
    if (!protocol::text(message.palette()).empty()) add(colours, "palette");
    if (protocol::word(message.scale(), "linear") != "linear") add(colours, "scale");
    return note_of("on counts, which have no colours", colours);
}

std::string idle_options_note(const wire::Job& message, bool hides_nothing) {
    std::string boxes;
    if (hides_nothing && message.skip_hidden_boxes()) add(boxes, "skip_hidden_boxes");
    return note_of("without `hide` or `only`", boxes);
}

}  // namespace raynest::server
