#include "tests/integration/daemon.h"

#include <arpa/inet.h>
#include <doctest/doctest.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <iterator>
#include <sstream>
#include <thread>

namespace raynest::test {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds look_again{5};

/// Forks and executes; `output` becomes stdout and stderr, -1 keeps them.
pid_t spawn(const std::vector<std::string>& arguments, int output,
            std::size_t descriptors_max = 0) {
    std::vector<std::string> words = {RAYNEST_DAEMON};
    words.insert(words.end(), arguments.begin(), arguments.end());
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    const pid_t pid = fork();
    if (pid != 0) return pid;
    const rlimit descriptors{descriptors_max, descriptors_max};
    if (descriptors_max != 0) setrlimit(RLIMIT_NOFILE, &descriptors);
    if (output >= 0) {
        dup2(output, STDOUT_FILENO);
        dup2(output, STDERR_FILENO);
    }
    execv(argv[0], argv.data());
    _exit(127);
}

std::optional<int> wait_for(pid_t pid, Clock::duration time) {
    const Clock::time_point end = Clock::now() + time;
    for (;;) {
        int status = 0;
        if (waitpid(pid, &status, WNOHANG) == pid)
            return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
        if (Clock::now() > end) return std::nullopt;
        std::this_thread::sleep_for(look_again);
    }
}

}  // namespace

void tally(std::string_view clients, std::size_t count, std::string_view outcome) {
    std::cout << "tally: " << clients << ": " << count << ": " << outcome << std::endl;
}

Daemon::Daemon(const std::vector<std::string>& arguments, std::size_t descriptors_max) {
    const std::filesystem::path ready = folder() / "ready.json";
    std::vector<std::string> all = {"--cuda",       "off",         "--http",
                                    "off",          "--listen",    "tcp://127.0.0.1:0",
                                    "--ready-file", ready.string()};
    all.insert(all.end(), arguments.begin(), arguments.end());
    const int output = open((folder() / "log").c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
    pid_ = spawn(all, output, descriptors_max);
    close(output);

    std::optional<int> ended;
    eventually([&] {
        ended = wait_for(pid_, {});
        return ended || std::filesystem::exists(ready);
    });
    if (!std::filesystem::exists(ready)) {
        if (!ended) end_by_force();  // a failing constructor calls no destructor
        FAIL("raynestd did not become ready: ", log());
    }
    const auto content = nlohmann::json::parse(std::ifstream(ready));
    CHECK(content["pid"] == pid_);
    const std::string uri = content["listen"][0];
    port_ = static_cast<std::uint16_t>(std::stoul(uri.substr(uri.rfind(':') + 1)));
}

Daemon::~Daemon() {
    if (pid_ <= 0) return;
    kill(pid_, SIGTERM);
    // A sanitizer's finding ends the daemon with its own exit code; a leak does so only at the end.
    const auto code = wait_for(pid_, patience());
    CHECK_MESSAGE(code.value_or(0) == 0, log());
    if (code) return;
    FAIL_CHECK("raynestd does not end on SIGTERM: ", log());
    end_by_force();
}

void Daemon::end_by_force() {
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
}

std::string Daemon::log() const {
    std::ostringstream text;
    text << std::ifstream(folder() / "log").rdbuf();
    return text.str();
}

void Daemon::signal(int number) const {
    REQUIRE(kill(pid_, number) == 0);
}

std::optional<int> Daemon::wait() {
    const auto code = wait_for(pid_, patience());
    if (code) pid_ = -1;
    return code;
}

std::uint64_t Daemon::memory(std::string_view key) const {
    std::ifstream status("/proc/" + std::to_string(pid_) + "/status");
    for (std::string word; status >> word;) {
        std::uint64_t kib = 0;
        if (word == key && status >> kib) return kib << 10;
    }
    FAIL("the daemon is gone");
    return 0;
}

std::size_t Daemon::descriptors() const {
    const std::filesystem::directory_iterator all("/proc/" + std::to_string(pid_) + "/fd");
    return static_cast<std::size_t>(std::distance(begin(all), end(all)));
}

std::size_t Daemon::logged(std::string_view text) const {
    std::ifstream log(folder() / "log");
    std::size_t count = 0;
    for (std::string line; std::getline(log, line);) count += line.find(text) != std::string::npos;
    return count;
}

Ended run_raynestd(const std::vector<std::string>& arguments) {
    const TemporaryFolder folder;
    const std::filesystem::path output = folder.path() / "output";
    const int file = open(output.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
    const pid_t pid = spawn(arguments, file);
    close(file);
    const auto code = wait_for(pid, patience());
    if (!code) {
        kill(pid, SIGKILL);
        waitpid(pid, nullptr, 0);
    }
    std::ostringstream text;
    text << std::ifstream(output).rdbuf();
    return {code.value_or(-1), text.str()};
}

Peer::Peer(std::uint16_t port) : socket_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    REQUIRE(connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0);
    const int one = 1;
    setsockopt(socket_, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
}

Peer::~Peer() {
    if (socket_ >= 0) close(socket_);
}

bool Peer::send(std::span<const std::byte> bytes) {
    while (!bytes.empty()) {
        const ssize_t sent = ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
        if (sent <= 0) return false;
        bytes = bytes.subspan(static_cast<std::size_t>(sent));
    }
    return true;
}

bool Peer::send_frame(const protocol::Frame& frame) {
    std::array<std::byte, protocol::header_bytes> header{};
    protocol::write_header(frame.header, header);
    return send(header) && send(frame.control.span()) && send(frame.bulk.span());
}

bool Peer::receive_some(std::size_t bytes) {
    std::vector<std::byte> forgotten(bytes);
    return recv(socket_, forgotten.data(), forgotten.size(), 0) > 0;
}

std::optional<protocol::Frame> Peer::read() {
    const Clock::time_point end = Clock::now() + patience();
    for (;;) {
        const auto taken = decoder_.feed(pending_);
        REQUIRE(taken);
        pending_.erase(pending_.begin(), pending_.begin() + static_cast<std::ptrdiff_t>(*taken));
        if (decoder_.complete()) return decoder_.take();

        pollfd wait{socket_, POLLIN, 0};
        const auto left = std::chrono::duration_cast<milliseconds>(end - Clock::now()).count();
        REQUIRE_MESSAGE(poll(&wait, 1, static_cast<int>(std::max<long long>(left, 0))) == 1,
                        "the daemon sent nothing");
        std::array<std::byte, 65536> bytes;
        const ssize_t got = recv(socket_, bytes.data(), bytes.size(), 0);
        if (got <= 0) return std::nullopt;
        pending_.insert(pending_.end(), bytes.begin(), bytes.begin() + got);
    }
}

protocol::Frame Peer::read_type(std::uint16_t type) {
    for (;;) {
        auto frame = read();
        REQUIRE_MESSAGE(frame.has_value(), "the stream ended before ",
                        protocol::message_name(type));
        if (frame->header.type == type) return std::move(*frame);
        if (const auto error = protocol::open<wire::Error>(*frame))
            FAIL("instead of ", protocol::message_name(type), ": ",
                 protocol::text((*error)->message()));
    }
}

std::optional<protocol::Code> Peer::read_error() {
    while (const auto frame = read())
        if (const auto error = protocol::open<wire::Error>(*frame))
            return static_cast<protocol::Code>((*error)->code());
    return std::nullopt;
}

bool Peer::ends() {
    while (read()) {
    }
    return true;
}

void Peer::greet(const wire::HelloT& hello) {
    REQUIRE(say(0, hello));
    read_until<wire::Welcome>();
}

bool Peer::pongs() {
    while (const auto frame = read())
        if (frame->header.type == static_cast<std::uint16_t>(wire::Message::Pong)) return true;
    return false;
}

void Peer::reset() {
    const linger at_once{1, 0};
    setsockopt(socket_, SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
    close(socket_);
    socket_ = -1;
}

void Peer::finish_sending() {
    shutdown(socket_, SHUT_WR);
}

void load_scene(Peer& peer) {
    wire::LoadT load;
    load.source = "builtin:terrain?size=16";
    load.name = "scene";
    REQUIRE(peer.say(2, load));
    peer.read_until<wire::Loaded>();
}

Served::Served(const std::vector<std::string>& arguments) : daemon(arguments) {
    peer.greet();
    load_scene(peer);
}

wire::QueryT query_of(std::uint64_t rays) {
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "scene";
    query.ray_count = rays;
    return query;
}

protocol::Frame rays_frame(std::uint64_t id, std::uint64_t first, std::uint64_t count) {
    protocol::Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, 8, count);
    bulk.allocate();
    const std::span<float> values = bulk.block_as<float>(0);
    constexpr std::array<float, 8> down = {0.1F, 1000.0F, 0.1F, 0.0F, 0.0F, -1.0F, 0.0F, 1e30F};
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = down[i % down.size()];
    wire::QueryRaysT rays;
    rays.first_ray = first;
    return protocol::encode(id, std::move(rays), std::move(bulk)).value();
}

double counter(Peer& peer, std::string_view name) {
    REQUIRE(peer.say(3, wire::StatsT{}));
    const protocol::Frame frame = peer.read_until<wire::Statistics>();
    const auto statistics = protocol::open<wire::Statistics>(frame);
    REQUIRE(statistics);
    const std::vector<std::string> names = protocol::strings((*statistics)->names());
    const auto* values = (*statistics)->values();
    REQUIRE(values != nullptr);
    for (std::size_t i = 0; i < names.size(); ++i)
        if (names[i] == name) return values->Get(static_cast<flatbuffers::uoffset_t>(i));
    FAIL("no counter ", name);
    return 0;
}

void wait_for_idle(Peer& peer) {
    REQUIRE(
        eventually([&] { return counter(peer, "jobs_started") == counter(peer, "jobs_ended"); }));
}

wire::RenderT endless_render() {
    wire::RenderT render;
    render.job = std::make_unique<wire::JobT>();
    render.job->scene = "scene";
    render.job->traversal = "reference";
    render.width = 8192;
    render.height = 8192;
    render.encode = "raw";
    return render;
}

}  // namespace raynest::test
