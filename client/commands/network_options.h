// The options of access and administration, as CLI11 declares them. Included by options.cpp alone.
#pragma once

#include "client/commands/option_parts.h"
#include "protocol/subject.h"

#include <string>
#include <vector>

namespace raynest::client {

/// Options before the command that say how to reach and convince a daemon. The token has none: the
/// command line is visible to other users.
inline void add_access(CLI::App& app, AccessOptions& access) {
    app.add_option("--ca", access.tls.ca,
                   "PEM file of the CAs to trust with tls:// (RAYNEST_CA, else the system's)");
    app.add_option("--token-file", access.token_file,
                   "file with the token, mode 0600 (RAYNEST_TOKEN, else what `raynest login` kept)");
    app.add_option("--cert", access.tls.certificate,
                   "PEM file of this client's certificate (RAYNEST_CERT)");
    app.add_option("--key", access.tls.key, "PEM file of its key (RAYNEST_KEY)");
    app.add_option_function<std::string>(
           "--tls-verify", [&access](const std::string& word) { access.tls.verify = word == "on"; },
           "on | off: off accepts any certificate, also an attacker's (on)")
        ->check(CLI::IsMember({"on", "off"}));
}

inline void add_reconnect(CLI::App& app, double& seconds) {
    app.add_option("--reconnect", seconds,
                   "seconds to look for a daemon that went away, as in a restart, and then to run the "
                   "command again where that is safe; 0: never (10)")
        ->envname("RAYNEST_RECONNECT")
        ->check(CLI::Validator(
            [](const std::string& text) {
                double number = -1;
                const bool is_number = CLI::detail::lexical_cast(text, number);
                return is_number && number >= 0 && number <= 3600 ? std::string()
                                                                  : "'" + text + "' is not 0 to 3600";
            },
            ""));
}

inline void add_share(CLI::App& app, LoadOptions& load) {
    app.add_option_function<std::vector<std::string>>(
           "--share",
           [&load](const std::vector<std::string>& lists) {
               for (const std::string& list : lists) {
                   const auto names = protocol::split_principals(list);
                   if (!names) throw CLI::ValidationError("--share", names.error());
                   load.share.insert(load.share.end(), names->begin(), names->end());
               }
           },
           "who else may use the scene: public, or principals as NAME,..., repeatable; '\\,' is a "
           "comma in a name, as in CN=robot\\,O=Lab (its owner alone)")
        ->type_name("TEXT")
        ->allow_extra_args(false)
        ->take_all();
}

inline void declare(CLI::App& app, LoginOptions& login) {
    app.add_option("URI", login.uri, "tls://HOST:PORT or another --server; the token is read from "
                                     "the terminal or stdin")
        ->required();
}

inline void declare(CLI::App& app, LogoutOptions& logout) {
    app.add_option("URI", logout.uri, "the daemon, as login was given it (--server)");
}

inline void declare(CLI::App& app, AdminOptions& admin) {
    app.add_option("ACT", admin.act,
                   "connections: list them; drain: end when all jobs have ended; reload: read "
                   "certificates, tokens and configuration again; kick: end connections; quota: "
                   "tell or change what a principal may have")
        ->required()
        ->check(CLI::IsMember({"connections", "drain", "reload", "kick", "quota"}));
    app.add_option("TARGET", admin.target,
                   "of kick: a connection's number or a principal; of quota: a principal");
    app.add_option("QUOTA", admin.quota,
                   "of quota: connections=N, jobs=N, rays=N, scene_bytes=N, second_bytes=N; bytes "
                   "also as 20G; without any, what the principal uses is told");
    app.parse_complete_callback([&admin] {
        const bool needs_target = admin.act == "kick" || admin.act == "quota";
        if (needs_target && admin.target.empty()) throw CLI::RequiredError("TARGET");
        if (!needs_target && !admin.target.empty())
            throw CLI::ValidationError("TARGET", "goes with kick and quota only");
        if (admin.act != "quota" && !admin.quota.empty())
            throw CLI::ValidationError("QUOTA", "goes with quota, such as: admin quota alice jobs=8");
    });
}

}  // namespace raynest::client
