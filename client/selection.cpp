#include "client/selection.h"

#include "client/explanation.h"
#include "client/numbers.h"
#include "client/picture.h"

#include <charconv>
#include <cstdint>
#include <optional>
#include <string_view>
#include <utility>

namespace raynest::client {
namespace {

constexpr std::string_view instance_key = "inst=";
constexpr std::string_view object_key = "object=";

/// The number behind a key; nothing if the text has another key or no number.
std::optional<std::uint32_t> number_of(std::string_view text, std::string_view key) {
    if (!text.starts_with(key)) return std::nullopt;
    text.remove_prefix(key.size());
    std::uint32_t number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
    return number;
}

bool is_numbered(std::string_view text) {
    return number_of(text, instance_key) || number_of(text, object_key);
}

/// The outermost instance on the way to a path, as "inst=N".
Result<std::string> instance_of(Context& context, const std::string& scene,
                                const std::string& text) {
    wire::PathT path;
    path.scene = scene;
    path.text = text;
    const auto found = ask<wire::PathName>(context.connection, path);
    if (!found) return tl::unexpected<Failure>(found.error());
    wire::StructureT structure;
    structure.scene = scene;
    structure.kind = "placements";
    structure.first = (*found)->path();
    structure.count = 1;
    if (auto started = context.connection.start(structure); !started)
        return tl::unexpected<Failure>(started.error());
    const auto answer = receive_picture(context.connection, context.progress);
    if (!answer) return tl::unexpected<Failure>(answer.error());
    const auto document = read_json(*answer);
    if (!document) return tl::unexpected<Failure>(document.error());
    const Json& rows = document->at("rows");
    if (rows.empty() || !rows[0].at("instance").is_number())
        return fail(Exit::usage, "'" + text + "' lies in no instance: it cannot be hidden");
    return std::string(instance_key) +
           std::to_string(rows[0].at("instance").get<std::uint64_t>());
}

}  // namespace

Result<void> check_selection(const std::string& text) {
    if (is_numbered(text)) return {};
    if (text.starts_with(instance_key) || text.starts_with(object_key))
        return fail(Exit::usage, "'" + text + "' has no whole number behind its '='");
    if (text.empty()) return fail(Exit::usage, "names nothing");
    return {};
}

Result<void> find_selection(Context& context, JobOptions& job) {
    for (auto* list : {&job.hide, &job.only}) {
        for (std::string& text : *list) {
            if (is_numbered(text)) continue;
            auto found = instance_of(context, job.scene, text);
            if (!found) return tl::unexpected<Failure>(found.error());
            text = std::move(*found);
        }
    }
    return {};
}

void add_selection(const JobOptions& options, wire::JobT& job) {
    const auto add = [](const std::vector<std::string>& texts, auto& instances, auto& objects) {
        for (const std::string& text : texts) {
            if (const auto instance = number_of(text, instance_key)) instances.push_back(*instance);
            if (const auto object = number_of(text, object_key)) objects.push_back(*object);
        }
    };
    add(options.hide, job.hidden_instances, job.hidden_objects);
    add(options.only, job.only_instances, job.only_objects);
    job.skip_hidden_boxes = options.skip_hidden_boxes;
}

}  // namespace raynest::client
