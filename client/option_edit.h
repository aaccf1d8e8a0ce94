// The options of `raynest edit`, as CLI11 declares them. Included by options.cpp alone.
#pragma once

#include "client/numbers.h"
#include "client/option_parts.h"
#include "client/options.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

namespace raynest::client {

/// Reads PATH=NUMBERS or PATH=HEX; returns what is wrong, or "".
inline std::string read_change(EditChange::What what, const std::string& text, EditOptions& edit) {
    const std::size_t equals = text.rfind('=');
    if (equals == 0 || equals == std::string::npos) return "'" + text + "' is not PATH=...";
    EditChange change{what, text.substr(0, equals)};
    const std::string value = text.substr(equals + 1);
    if (what == EditChange::mask) {
        const auto mask = parse_mask(value);
        if (!mask) return mask.error().message;
        change.new_mask = *mask;
    } else {
        const bool is_move = what == EditChange::move;
        const auto numbers = parse_world(value, is_move ? 3 : 12, 12,
                                         is_move ? "dx,dy,dz or a 3x4 matrix row by row"
                                                 : "a 3x4 matrix row by row");
        if (!numbers) return numbers.error().message;
        if (numbers->size() == 3)
            for (std::size_t row = 0; row < 3; ++row) change.matrix[4 * row + 3] = (*numbers)[row];
        else
            std::ranges::copy(*numbers, change.matrix.begin());
    }
    edit.changes.push_back(std::move(change));
    return "";
}

inline void declare(CLI::App& app, EditOptions& edit) {
    app.add_option("SCENE", edit.scene, "name of a loaded scene of yours")->required();
    const auto add = [&](const std::string& name, auto read, const std::string& text) {
        app.add_option_function<std::string>(
               name,
               [name, read](const std::string& given) {
                   if (const std::string fault = read(given); !fault.empty())
                       throw CLI::ValidationError(name, fault);
               },
               text)
            ->trigger_on_parse()
            ->multi_option_policy(CLI::MultiOptionPolicy::TakeLast)
            ->allow_extra_args(false);
    };
    add("--move", [&edit](const auto& text) { return read_change(EditChange::move, text, edit); },
        "PATH=DX,DY,DZ, or PATH= and a 3x4 matrix row by row: moves what stands there, in the world. In "
        "PATH * stands for any text, and all below a path moves with it; inst=N is the outermost "
        "instance N. May be repeated, also the options below; they act in their order");
    add("--place", [&edit](const auto& text) { return read_change(EditChange::place, text, edit); },
        "PATH= and a 3x4 matrix row by row: from the object's own coordinates to the world's");
    add("--set-mask", [&edit](const auto& text) { return read_change(EditChange::mask, text, edit); },
        "PATH=HEX: its mask from now on (see: query --mask)");
    const auto set = [&edit](std::uint32_t mask) {
        return [&edit, mask](const std::string& path) -> std::string {
            EditChange change{EditChange::mask, path};
            change.new_mask = mask;
            edit.changes.push_back(std::move(change));
            return "";
        };
    };
    add("--hide", set(0), "PATH: no ray meets it from now on");
    add("--show", set(~0U), "PATH: every ray may meet it");
    add_epoch(app, edit.epoch);
    app.parse_complete_callback([&edit] {
        if (edit.changes.empty())
            throw CLI::RequiredError("--move, --place, --set-mask, --hide or --show");
    });
}

}  // namespace raynest::client
