// LOAD: imports uploaded files, a built-in scene or a file under --scene-root as a named scene. The
// start of the daemon loads the sources of --load in the same way.
//
//   upload:  NEED ──► UPLOAD pieces ──► import       builtin:, root:, --load  import at once
//
// An upload whose files' digests make a scene that the caller may see is published without being
// sent.
#include "engine/assets/composition/compose.h"
#include "engine/assets/input/mask_rules.h"
#include "protocol/hash.h"
#include "protocol/openssl.h"
#include "protocol/text.h"
#include "server/jobs/load_job.h"
#include "server/requests/load_at_start.h"
#include "server/requests/request.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::string_view builtin_scheme = "builtin:";
constexpr std::string_view root_scheme = "root:";
bool starts_with(std::string_view text, std::string_view prefix) {
    return text.substr(0, prefix.size()) == prefix;
}

/// Returns the name of a scene from its source: "root:maps/town.v2.glb" -> "town.v2" (as the client
/// does for uploads), "builtin:forest?trees=9" -> "forest".
std::string default_name(std::string_view source) {
    if (starts_with(source, builtin_scheme))
        source = source.substr(builtin_scheme.size(), source.find('?') - builtin_scheme.size());
    if (starts_with(source, root_scheme)) source.remove_prefix(root_scheme.size());
    source = source.substr(source.rfind('/') + 1);
    if (is_composition(source)) source.remove_suffix(std::string_view(".json").size());
    return protocol::single_blanks(source.substr(0, source.rfind('.')));
}

/// Returns the digest of everything that the import of an upload depends on, or "" where the client
/// gives no digests.
std::string digest_of(const LoadOrder& order) {
    protocol::Sha256 sum;
    const auto add = [&](const void* bytes, std::uint64_t size) {
        sum.add(std::as_bytes(std::span(&size, 1)));
        sum.add({static_cast<const std::byte*>(bytes), size});
    };
    const auto add_text = [&](std::string_view text) { add(text.data(), text.size()); };
    add_text(order.source);
    add_text(order.primitive);
    add_text(build_quality_names[static_cast<std::size_t>(order.build)]);
    add(order.origin.data(), sizeof order.origin);
    const FileOptions& options = order.options;
    // Scenes that earlier releases turned to +Y have 1 here.
    constexpr double z_is_up = 2;
    const std::array<double, 5> given{options.unit, options.radius, options.spacing,
                                      options.z_up ? z_is_up : 0.0,
                                      options.auto_origin ? 1.0 : 0.0};
    add(given.data(), sizeof given);
    const std::array<std::uint64_t, 2> counts{order.masks.size(), order.files.size()};
    add(counts.data(), sizeof counts);
    for (const std::string& mask : order.masks) add_text(mask);
    for (const UploadFile& file : order.files) {
        if (!file.digest) return {};
        add_text(file.name);
        add(file.digest->data(), file.digest->size());
    }
    // Sums of earlier releases, which stored scenes have, end with the files.
    if (!order.variant.empty()) add_text(order.variant);
    const auto digest = order.files.empty() ? std::nullopt : sum.digest();
    return digest ? std::string(digest->begin(), digest->end()) : std::string();
}

/// Fills in order.files from the message and allocates their memory.
Reply<void> read_files(const Services& services, const wire::Load& message, LoadOrder& order) {
    const std::vector<std::string> names = protocol::strings(message.file_names());
    const bool upload = !order.disk && !starts_with(order.source, builtin_scheme);
    if (upload == names.empty())
        return refuse(Code::invalid_field,
                      upload ? "'" + order.source + "' needs its files: file_names is empty"
                             : "'" + order.source + "' takes no files");
    const auto* const digests = message.file_digests();
    const auto* const hashes = message.file_hashes();
    for (std::size_t i = 0; i < names.size(); ++i) {
        UploadFile& file = order.files.emplace_back();
        file.name = names[i];
        if (hashes != nullptr && hashes->size() != 0)
            file.hash = hashes->Get(static_cast<flatbuffers::uoffset_t>(i));
        if (digests == nullptr || digests->size() == 0) continue;
        auto& digest = file.digest.emplace();
        std::copy_n(digests->data() + i * digest.size(), digest.size(), digest.begin());
    }
    order.publication.made_of = digest_of(order);
    if (!order.publication.made_of.empty())
        order.known = services.scenes.find_made_of(order.publication.made_of, order.caller);
    if (order.known) return {};
    std::uint64_t total = 0;
    for (std::size_t i = 0; i < names.size(); ++i)
        total += message.file_bytes()->Get(static_cast<flatbuffers::uoffset_t>(i));
    // Refuse an upload for which no room can be made, before it is sent. Room is made, and reserved,
    // piece by piece: one that is announced but not sent takes nothing from others.
    const std::string& principal = order.caller.principal;
    if (total > services.scenes.most_room(principal, services.peers.reclaimable_bytes(principal)))
        return services.budget.refuse(
            "the upload", total, principal,
            services.scenes.remedy(principal, "start raynestd with a larger --memory"));
    for (std::size_t i = 0; i < names.size(); ++i)
        order.files[i].bytes =
            protocol::Buffer(message.file_bytes()->Get(static_cast<flatbuffers::uoffset_t>(i)));
    return {};
}

/// Reads how to take a file without units. Lengths up to 1e9 keep all products finite.
Reply<FileOptions> options_of(const wire::Load& message) {
    FileOptions options{message.unit(), message.radius(), message.spacing(),
                        protocol::text(message.up()) == "z", message.origin_auto()};
    const std::string_view up = protocol::word(message.up(), "y");
    if (up != "y" && up != "z")
        return refuse(Code::invalid_field, "unknown up '" + std::string(up) + "': use one of y, z");
    constexpr double least = 1e-9, most = 1e9;
    for (const auto& [name, value] :
         {std::pair{"unit", options.unit}, std::pair{"radius", options.radius},
          std::pair{"spacing", options.spacing}}) {
        if (value != 0 && !(value >= least && value <= most))
            return refuse(Code::invalid_field,
                          std::string("`") + name + "` is a length of 1e-9 to 1e9, or 0 for none");
    }
    if (options.auto_origin &&
        (message.origin_x() != 0 || message.origin_y() != 0 || message.origin_z() != 0))
        return refuse(Code::invalid_field, "give an origin or origin_auto, not both");
    return options;
}

Reply<void> check_name(const Services& services, const LoadOrder& order) {
    if (order.name.empty() || order.name.size() > services.limits.name_bytes_max)
        return refuse(Code::invalid_field, "the scene needs a name of 1.." +
                                               std::to_string(services.limits.name_bytes_max) +
                                               " bytes; pass another `name`");
    if (order.name.find('/') != std::string::npos)
        return refuse(Code::invalid_field, "the name '" + order.name +
                                               "' has a '/', which stands after an owner's name; "
                                               "pass another `name`");
    if (protocol::has_hidden_letter(order.name))
        return refuse(Code::invalid_field,
                      "the name '" + protocol::clean_text(order.name, order.name.size()) +
                          "' has a letter that nobody sees, where '?' is; pass another `name`");
    if (protocol::has_unassigned_letter(order.name))
        return refuse(
            Code::invalid_field,
            "the name '" + order.name +
                "' has a letter that Unicode does not know, or that each font draws in its "
                "own way; pass another `name`");
    if (order.name != protocol::single_blanks(order.name))
        return refuse(Code::invalid_field, "the name '" + order.name +
                                               "' has a blank at an end, or two side by side; "
                                               "pass another `name`");
    for (const std::string_view principal : order.publication.share.names())
        if (protocol::has_hidden_letter(principal))
            return refuse(Code::invalid_field,
                          "the scene is shared with '" +
                              protocol::clean_text(principal, principal.size()) +
                              "', which has a letter that nobody sees, where '?' is; leave it out");
    return {};
}

JobSubmission submission_of(const Services& services, const Caller& caller, LoadOrder order) {
    JobSubmission accepted;
    accepted.kind = "load";
    accepted.scene = order.name;
    for (const UploadFile& file : order.files) accepted.input_bytes += file.bytes.size();
    accepted.job = load_job(services, caller, std::move(order));
    return accepted;
}

}  // namespace

Reply<JobSubmission> load_at_start(const Services& services, const Caller& caller,
                                   const std::string& source) {
    LoadOrder order;
    order.source = source;
    order.name = default_name(source);
    order.caller = caller;
    order.publication.share = ShareList{"public"};
    // The file of a scene that a daemon before this one has stored may have changed.
    order.publication.replace = services.scenes.is_from_before(order.name, caller);
    if (starts_with(source, root_scheme)) {
        order.disk = {services.scene_root, source.substr(root_scheme.size())};
    } else if (!starts_with(source, builtin_scheme)) {
        // A link may lead anywhere; its target's folder has the files that the scene names.
        std::error_code error;
        const auto file = std::filesystem::canonical(source, error);
        if (error) return refuse(Code::scene_invalid, error.message());
        order.disk = {file.parent_path(), file.filename().string()};
    }
    if (const auto name = check_name(services, order); !name) return tl::unexpected(name.error());
    if (const auto quota = services.scenes.check_quota(order.name, caller, 0); !quota)
        return tl::unexpected(quota.error());
    return submission_of(services, caller, std::move(order));
}

Reply<Answer> load(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Load>& message) {
    const std::string_view build = protocol::word(message->build(), "medium");
    const auto quality = std::find(build_quality_names.begin(), build_quality_names.end(), build);
    if (quality == build_quality_names.end())
        return refuse(Code::invalid_field,
                      "unknown build '" + std::string(build) + "': use one of fast, medium, high");
    LoadOrder order;
    order.build = static_cast<BuildQuality>(quality - build_quality_names.begin());
    order.source = protocol::text(message->source());
    order.name = protocol::word(message->name(), default_name(order.source));
    order.primitive = protocol::text(message->primitive());
    order.caller = caller;
    order.publication = {message->replace(), message->temporary(),
                         protocol::strings(message->share())};
    order.origin = {message->origin_x(), message->origin_y(), message->origin_z()};
    const auto options = options_of(*message.table);
    if (!options) return tl::unexpected(options.error());
    order.options = *options;
    order.masks = protocol::strings(message->masks());
    order.variant = protocol::text(message->variant());
    if (const auto rules = MaskRules::parse(order.masks); !rules)
        return refuse(Code::invalid_field, rules.error().message);
    // `builtin:` alone goes on: its import fails with the list of those there are.
    if (order.name.empty() && starts_with(order.source, builtin_scheme)) order.name = "builtin";
    if (const auto name = check_name(services, order); !name) return tl::unexpected(name.error());
    if (starts_with(order.source, root_scheme))
        order.disk = {services.scene_root, order.source.substr(root_scheme.size())};
    // Check the quota before the upload.
    if (const auto quota = services.scenes.check_quota(order.name, caller, 0); !quota)
        return tl::unexpected(quota.error());
    if (const auto files = read_files(services, *message.table, order); !files)
        return tl::unexpected(files.error());

    JobSubmission accepted = submission_of(services, caller, std::move(order));
    accepted.deadline_ms = message->deadline_ms();
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
