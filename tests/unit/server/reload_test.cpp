// Tests what a reload takes: never what would open an address further than it is open.
#include "server/options/reload.h"

#include "server/options/limits_in_force.h"
#include "server/security/certificates.h"
#include "server/security/pem_file.h"
#include "tests/temporary_folder.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iostream>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

using Place = PeerIdentity::Place;

ListenAddress at(const std::string& option, const std::string& value) {
    return {option, value,
            (option == "http" ? parse_http_address(value) : parse_address(value)).value()};
}

/// One address of each kind, and the access to Unix sockets.
struct Listening {
    ListenAddress address;
    SocketAccess socket = {};
    bool insecure = false;
};

const std::vector<Listening>& addresses() {
    static const std::vector<Listening> all = {
        {at("listen", "tcp://127.0.0.1:1")}, {at("listen", "tcp://0.0.0.0:1"), {}, true},
        {at("listen", "tls://127.0.0.1:1")}, {at("listen", "tls://[::]:1")},
        {at("listen", "unix:/s")},           {at("listen", "unix:/s"), {0660, 1U}},
        {at("http", "127.0.0.1:1")},         {at("http", "0.0.0.0:1"), {}, true},
        {at("http", "https://127.0.0.1:1")}, {at("http", "https://192.0.2.1:1")},
    };
    return all;
}

/// Every combination of options of security, with two values of each file.
std::vector<SecurityOptions> all_options(bool insecure) {
    std::vector<SecurityOptions> all;
    for (const char* certificate : {"", "a", "b"})
        for (const char* ca : {"", "c", "d"})
            for (const char* tokens : {"", "t", "u"})
                for (const std::optional<Role> role :
                     {std::optional<Role>(), std::optional(Role::viewer),
                      std::optional(Role::user)})
                    if (*certificate != '\0' || *ca == '\0')
                        all.push_back({{certificate, certificate, ca}, tokens, role, insecure});
    return all;
}

TEST_CASE("no reload opens an address further than it is open, on any transport") {
    std::size_t taken = 0;
    std::size_t refused = 0;
    for (const Listening& one : addresses()) {
        CAPTURE(one.address.value);
        const auto options = all_options(one.insecure);
        for (const SecurityOptions& now : options) {
            const Openness before = openness(one.address, now, one.socket);
            if (!before.fault.empty()) continue;  // it would not start
            CHECK(weakened({one.address}, now, now, one.socket).empty());
            for (const SecurityOptions& then : options) {
                if (!weakened({one.address}, now, then, one.socket).empty()) {
                    ++refused;
                    continue;
                }
                ++taken;
                const Openness after = openness(one.address, then, one.socket);
                CHECK(after.fault.empty());
                for (const auto& [place, role] : after.strangers)
                    CHECK(role <= before.strangers.at(place));
                // The rows of the token file also shut certificates out.
                if (before.certificates && before.tokens && after.certificates) CHECK(after.tokens);
            }
        }
    }
    CHECK(taken > 1000);
    CHECK(refused > 1000);
}

/// A daemon's options and files, without a daemon.
struct Running {
    test::TemporaryFolder folder;
    Options options;
    std::vector<ListenAddress> open;
    protocol::Limits limits;
    std::unique_ptr<Credentials> credentials;

    Running() {
        for (const char* name : {"a", "b"})
            REQUIRE(make_certificates(folder.file(name), {"localhost"}));
        for (const char* name : {"t", "u"}) {
            TokenTable table;
            table.put({TokenRow::Kind::token, name, Role::user, hash_token(name), {}, {}});
            REQUIRE(table.write(folder.file(name)));
        }
        options.security = {files("a"), folder.file("t"), Role::viewer, false};
    }
    [[nodiscard]] TlsFiles files(const std::string& name) const {
        return {folder.file(name + "/cert.pem"), folder.file(name + "/key.pem"),
                folder.file(name + "/ca.pem")};
    }
    void start() {
        credentials = std::make_unique<Credentials>(options.security, limits);
        REQUIRE(credentials->load());
        options.listen = {};
        for (const ListenAddress& address : open) options.listen.push_back(address.value);
    }
    Reload reload(const Options& then) {
        const auto read = [&] { return Result<Options>(then); };
        return reload_options(options, read_again(read, options.security), *credentials, open);
    }
    /// Reads the token file again if it is another; true if it is good.
    bool look() {
        return credentials->tokens_changed() &&
               credentials->take(Credentials::read_tokens(credentials->options()));
    }
    /// The role of a peer without token and certificate, by what counts now.
    [[nodiscard]] std::string stranger(const char* transport, Place place) {
        const auto found = credentials->authentication().identify({"p", place, transport}, "", {},
                                                                  WallClock::now());
        return found ? std::string(role_name(found->role)) : "refused";
    }
};

TEST_CASE("each option of security, set, changed and removed by a reload") {
    struct Row {
        const char* name;
        std::function<void(const Running&, SecurityOptions&)> before;
        std::function<void(const Running&, SecurityOptions&)> change;
        const char* names;    ///< names of the options that change
        const char* refused;  ///< letters of transports on which the reload leaves them
    };
    using Run = const Running&;
    using Security = SecurityOptions&;
    const auto as_it_is = [](Run, Security) {};
    // Letters: t plain TCP, T TLS, u a Unix socket for its user, U one for all, h HTTP, H HTTPS.
    const Row rows[] = {
        {"tls set", [](Run, Security s) { s.tls = {}; },
         [](Run r, Security s) { s.tls = r.files("a"); }, "tls-cert,tls-key,client-ca", ""},
        {"tls changed", as_it_is, [](Run r, Security s) { s.tls = r.files("b"); },
         "tls-cert,tls-key,client-ca", ""},
        {"tls removed", as_it_is, [](Run, Security s) { s.tls = {}; }, "tls-cert,tls-key,client-ca",
         "TH"},
        {"client-ca set", [](Run, Security s) { s.tls.client_ca.clear(); },
         [](Run r, Security s) { s.tls.client_ca = r.files("a").client_ca; }, "client-ca", ""},
        {"client-ca changed", as_it_is,
         [](Run r, Security s) { s.tls.client_ca = r.files("b").client_ca; }, "client-ca", ""},
        {"client-ca removed", as_it_is, [](Run, Security s) { s.tls.client_ca.clear(); },
         "client-ca", ""},
        {"client-ca removed without tokens", [](Run, Security s) { s.tokens.clear(); },
         [](Run, Security s) { s.tls.client_ca.clear(); }, "client-ca", "TH"},
        {"tokens set", [](Run, Security s) { s.tokens.clear(); },
         [](Run r, Security s) { s.tokens = r.folder.file("t"); }, "tokens", ""},
        {"tokens changed", as_it_is, [](Run r, Security s) { s.tokens = r.folder.file("u"); },
         "tokens", ""},
        {"tokens removed", as_it_is, [](Run, Security s) { s.tokens.clear(); }, "tokens", "TH"},
        {"tokens removed without client-ca", [](Run, Security s) { s.tls.client_ca.clear(); },
         [](Run, Security s) { s.tokens.clear(); }, "tokens", "TH"},
        {"anonymous off", as_it_is, [](Run, Security s) { s.anonymous.reset(); }, "anonymous", ""},
        {"anonymous raised", as_it_is, [](Run, Security s) { s.anonymous = Role::user; },
         "anonymous", "tUh"},
        {"anonymous let in", [](Run, Security s) { s.anonymous.reset(); },
         [](Run, Security s) { s.anonymous = Role::viewer; }, "anonymous", "tUh"},
        {"everything", as_it_is, [](Run, Security s) { s = {}; },
         "tls-cert,tls-key,client-ca,tokens,anonymous", "tTUhH"},
    };
    const std::array<std::pair<char, Listening>, 6> kinds = {{
        {'t', {at("listen", "tcp://127.0.0.1:1")}},
        {'T', {at("listen", "tls://127.0.0.1:1")}},
        {'u', {at("listen", "unix:/s")}},
        {'U', {at("listen", "unix:/s"), {0666, {}}}},
        {'h', {at("http", "127.0.0.1:1")}},
        {'H', {at("http", "https://127.0.0.1:1")}},
    }};
    for (const Row& row : rows)
        for (const auto& [letter, one] : kinds) {
            INFO(std::string(row.name), " on ", letter);
            Running running;
            running.open = {one.address};
            running.options.socket = one.socket;
            row.before(running, running.options.security);
            running.start();
            const SecurityOptions old = running.options.security;
            const std::string was = running.stranger("tls", Place::loopback);
            Options then = running.options;
            row.change(running, then.security);
            const Reload done = running.reload(then);
            const bool stays = std::string(row.refused).find(letter) != std::string::npos;
            CHECK(done.fault.empty());
            CHECK(done.changed == (stays ? "" : row.names));
            CHECK(done.needs_restart == (stays ? row.names : ""));
            CHECK(done.weaker.empty() != stays);
            CHECK(running.options.security == (stays ? old : then.security));
            CHECK(running.credentials->options() == running.options.security);
            if (stays) CHECK(running.stranger("tls", Place::loopback) == was);
            // A start with these options gives the same.
            Credentials anew(running.options.security, running.limits);
            REQUIRE(anew.load());
            CHECK(anew.authentication().tokens().rows() ==
                  running.credentials->authentication().tokens().rows());
            CHECK((anew.tls() == nullptr) == (running.credentials->tls() == nullptr));
        }
}

TEST_CASE(
    "a reload that would weaken one address changes no option of security, and takes the others") {
    Running running;
    running.open = {at("listen", "tls://127.0.0.1:1"), at("listen", "tcp://127.0.0.1:2")};
    running.start();
    Options then = running.options;
    then.listen = {"tcp://127.0.0.1:2"};
    then.security = {{}, {}, std::nullopt, true};
    then.log_level = LogLevel::error;
    const Reload done = running.reload(then);
    CHECK(done.changed == "log-level");
    CHECK(done.needs_restart == "tls-cert,tls-key,client-ca,tokens,anonymous,insecure,listen");
    CHECK(done.weaker.starts_with("tls://127.0.0.1:1 "));
    CHECK(running.stranger("tls", Place::loopback) == "refused");
    CHECK(running.stranger("tcp", Place::loopback) == "viewer");
}

TEST_CASE(
    "an unusable file of a new option leaves all options of security, and their files are read") {
    Running running;
    running.open = {at("listen", "tls://127.0.0.1:1")};
    running.start();
    const SecurityOptions old = running.options.security;
    TokenTable table;
    table.put({TokenRow::Kind::token, "new", Role::user, hash_token("new"), {}, {}});
    REQUIRE(table.write(running.folder.file("t")));
    Options then = running.options;
    then.security.tokens = running.folder.file("nosuch");
    then.security.anonymous.reset();
    const Reload done = running.reload(then);
    CHECK(done.fault.find("nosuch") != std::string::npos);
    CHECK(done.changed.empty());
    CHECK(done.needs_restart.empty());
    CHECK(running.options.security == old);
    CHECK(running.credentials->authentication().tokens().find_name("new") != nullptr);
    // The old file is still the one that is watched.
    CHECK_FALSE(running.look());
    table.put({TokenRow::Kind::token, "more", Role::user, hash_token("more"), {}, {}});
    REQUIRE(table.write(running.folder.file("t")));
    CHECK(running.look());
}

TEST_CASE("a token file that is written in place counts once it is whole") {
    Running running;
    running.start();
    Authentication& daemon = running.credentials->authentication();
    const std::string file = running.folder.file("t");
    const std::string row = daemon.tokens().to_text();
    std::ofstream(file, std::ios::trunc) << "";
    CHECK_FALSE(running.look());
    CHECK(daemon.tokens().find_name("t") != nullptr);
    std::ofstream(file, std::ios::app) << row;
    CHECK_FALSE(running.look());
    CHECK(running.look());
    CHECK(daemon.tokens().find_name("t") != nullptr);
    CHECK_FALSE(running.look());
    // One that is moved into place is whole.
    REQUIRE(TokenTable().write(file));
    CHECK(running.look());
    CHECK(daemon.tokens().rows().empty());
}

TEST_CASE("a token file that cannot be read is asked again") {
    Running running;
    running.start();
    Authentication& daemon = running.credentials->authentication();
    const std::string file = running.folder.file("t");
    REQUIRE(TokenTable().write(file));
    const auto folder = std::filesystem::path(file).parent_path();
    using std::filesystem::perms;
    std::filesystem::permissions(folder, perms::all);
    CHECK_FALSE(running.look());
    CHECK_FALSE(running.look());
    CHECK(daemon.tokens().find_name("t") != nullptr);
    std::filesystem::permissions(folder, perms::owner_all);
    CHECK(running.look());
    CHECK(daemon.tokens().rows().empty());
    CHECK_FALSE(running.look());
}

TEST_CASE("tokens that a reload brings are watched, and go with the option") {
    Running running;
    running.open = {at("listen", "tcp://127.0.0.1:1")};
    running.options.security.tokens.clear();
    running.start();
    Options then = running.options;
    then.security.tokens = running.folder.file("t");
    CHECK(running.reload(then).changed == "tokens");
    Authentication& daemon = running.credentials->authentication();
    const PeerIdentity peer{"127.0.0.1", Place::loopback, "tcp"};
    const auto alice = daemon.identify(peer, "t", {}, WallClock::now());
    REQUIRE(alice);
    REQUIRE(TokenTable().write(running.folder.file("t")));
    CHECK(running.look());
    CHECK_FALSE(daemon.still_valid(*alice, WallClock::now()));
    then.security.tokens = running.folder.file("u");
    CHECK(running.reload(then).changed == "tokens");
    const auto other = daemon.identify(peer, "u", {}, WallClock::now());
    REQUIRE(other);
    then.security.tokens.clear();
    CHECK(running.reload(then).changed == "tokens");
    CHECK_FALSE(daemon.still_valid(*other, WallClock::now()));
    CHECK(daemon.tokens().rows().empty());
}

TEST_CASE("a certificate is verified once more after a reload, not each time that somebody asks") {
    const Running running;
    const auto load = [&](const char* name) {
        return TlsContext::load(running.files(name)).value();
    };
    const auto now = WallClock::now();
    ClientCertificate shown;
    shown.expires = now + std::chrono::hours(1);
    auto chain = read_certificates(running.folder.file("a/client-cert.pem")).value();
    for (auto& one : chain) shown.chain.emplace_back(one.release(), X509_free);
    const auto before = load("a"), after = load("a"), other_ca = load("b");
    for (const auto& context : {before, after}) {
        CHECK(context->trusts(shown, now));
        CHECK(shown.verified_by == context);
    }
    CHECK_FALSE(other_ca->trusts(shown, now));
    CHECK(shown.verified_by == after);
    CHECK_FALSE(after->trusts(shown, now + std::chrono::hours(2)));
}

TEST_CASE("a reload takes each limit, or says that it waits for a restart") {
    std::size_t waiting = 0;
    for (const protocol::LimitInfo& limit : protocol::limit_table()) {
        if (!limit.policy) continue;
        Running running;
        running.start();
        Options then = running.options;
        ++(then.limits.*limit.value);
        std::string name(limit.name);
        std::ranges::replace(name, '_', '-');
        const Reload done = running.reload(then);
        CHECK(done.changed + done.needs_restart == name);
        const bool is_taken = running.options.limits.*limit.value == then.limits.*limit.value;
        CHECK(is_taken == done.needs_restart.empty());
        waiting += done.changed.empty();
    }
    CHECK(waiting == 6);
}

TEST_CASE("an option that waits for a restart changes nothing else before it") {
    Running running;
    const std::string state = running.folder.file("state");
    const std::string file = running.folder.file("t");
    const std::string folder = std::filesystem::path(file).parent_path();
    const auto parsed = [&](const std::vector<std::string>& more) {
        std::vector<std::string> words = {"raynestd", "--cuda=off", "--target=v3", "--memory=256M",
                                          "--state=" + state};
        for (const std::string& word : more) {
            const std::string option = word.substr(0, word.find('=') + 1);
            std::erase_if(words, [&](const auto& known) { return known.starts_with(option); });
            words.push_back(word);
        }
        std::vector<const char*> argv;
        for (const std::string& word : words) argv.push_back(word.c_str());
        const auto read =
            parse_options(static_cast<int>(argv.size()), argv.data(), std::cerr).options;
        REQUIRE(read);
        Options options = *read;
        options.security = running.options.security;
        return options;
    };
    running.start();
    // /dev/shm is another disk.
    for (const std::string& other :
         {std::string("--listen=tcp://127.0.0.1:2"), std::string("--http=127.0.0.1:3"),
          std::string("--socket-mode=0640"), "--scene-root=" + folder, "--load=" + file,
          "--pack-dir=" + folder, std::string("--threads=77"), std::string("--memory=8G"),
          std::string("--memory=16M"), std::string("--state=/dev/shm/elsewhere"),
          std::string("--target=v4"), "--cuda=" + file, "--ready-file=" + folder + "/ready"}) {
        CAPTURE(other);
        running.options = parsed({});
        const protocol::Limits before = limits_in_force(running.options);
        const std::string name = other.substr(2, other.find('=') - 2);
        const Reload done = running.reload(parsed({other}));
        CHECK(done.needs_restart == name);
        CHECK(done.changed.empty());
        const protocol::Limits after = limits_in_force(running.options);
        for (const protocol::LimitInfo& limit : protocol::limit_table()) {
            CAPTURE(limit.name);
            CHECK(before.*limit.value == after.*limit.value);
        }
    }
}

TEST_CASE("what is open to whom is told in words") {
    const SecurityOptions security{{"a", "a", "c"}, "t", Role::user, false};
    const auto told = [&](const std::string& uri, const SocketAccess& socket = {}) {
        return to_text(openness(at("listen", uri), security, socket));
    };
    CHECK(told("tls://0.0.0.0:1") == "tokens; certificates");
    CHECK(told("tcp://127.0.0.1:1") == "tokens; this machine as user");
    CHECK(told("unix:/s") == "tokens; the daemon's user and root as admin");
    CHECK(told("unix:/s", {0660, 1U}) ==
          "tokens; the daemon's user and root as admin; other users of this machine as user");
    CHECK(to_text(openness(at("listen", "tcp://127.0.0.1:1"), {{}, {}, std::nullopt, false}, {})) ==
          "nobody");
}

}  // namespace
}  // namespace raynest::server
