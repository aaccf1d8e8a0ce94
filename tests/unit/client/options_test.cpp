#include "client/commands/parse.h"
#include "client/commands/query.h"
#include "client/requests/film.h"
#include "protocol/control.h"
#include "tests/unit/client/fake_daemon.h"

#include <doctest/doctest.h>

#include <cmath>
#include <cstdlib>
#include <iterator>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

using namespace raynest::client;

namespace {

Result<Parsed> parse(const std::vector<std::string>& words) {
    std::vector<const char*> argv = {"raynest"};
    for (const std::string& word : words) argv.push_back(word.c_str());
    return parse_options(static_cast<int>(argv.size()), argv.data());
}

std::shared_ptr<Command> command_of(const std::vector<std::string>& words) {
    auto parsed = parse(words);
    REQUIRE_MESSAGE(parsed, (parsed ? "" : parsed.error().message));
    REQUIRE(parsed->options);
    return parsed->options->command;
}

template <class Options>
Options options_of(const std::vector<std::string>& words) {
    const std::shared_ptr<Command> command = command_of(words);
    const auto* with_options = dynamic_cast<const CommandOf<Options>*>(command.get());
    REQUIRE(with_options != nullptr);
    return with_options->options();
}

/// The first request of a command, whose daemon is gone then.
template <class Table>
auto request_of(const std::vector<std::string>& words) {
    raynest::protocol::Frame request;
    {
        FakeDaemon daemon([&](Peer& peer) {
            peer.welcome();
            request = peer.receive();
        });
        const auto connection = Connection::open(daemon.uri(), "");
        REQUIRE(connection);
        Progress progress(Progress::Style::none);
        const Access access;
        const std::string uri = daemon.uri();
        Context context{**connection, progress, false, {}, uri, access};
        CHECK(!command_of(words)->carry_out(context));
    }
    auto opened = raynest::protocol::open<Table>(request);
    REQUIRE(opened);
    return std::unique_ptr<typename Table::NativeTableType>((*opened)->UnPack());
}

std::vector<std::string> words_of(const std::string& line) {
    std::istringstream stream(line);
    return {std::istream_iterator<std::string>(stream), {}};
}

std::string complaint(const std::vector<std::string>& words) {
    const auto parsed = parse(words);
    REQUIRE(!parsed);
    CHECK(parsed.error().exit == Exit::usage);
    return parsed.error().message;
}

}  // namespace

TEST_CASE("login and logout name the daemon, logout else by --server") {
    const auto server_of = [](const std::string& line) {
        return parse(words_of(line))->options->server;
    };
    CHECK(server_of("--server tcp://a:1 login tls://b:2") == "tls://b:2");
    CHECK(server_of("--server tcp://a:1 logout tls://b:2") == "tls://b:2");
    CHECK(server_of("--server tcp://a:1 logout") == "tcp://a:1");
    CHECK(complaint(words_of("--local logout")).find("leave --local out") != std::string::npos);
}

TEST_CASE("the options of each command are understood") {
    const auto query = options_of<QueryOptions>({"query",
                                                 "forest",
                                                 "--ray",
                                                 "0,1,5,0,0,-1",
                                                 "--ray",
                                                 "-1,-2,-3,0.5,0,1,0,9",
                                                 "--kind",
                                                 "multi",
                                                 "--max-hits",
                                                 "4",
                                                 "--fields",
                                                 "t,path",
                                                 "--intersector",
                                                 "alpha_mask",
                                                 "--set",
                                                 "cutoff=0.3",
                                                 "--set",
                                                 "cull=back",
                                                 "--mask",
                                                 "0xFF",
                                                 "--deadline",
                                                 "2.5",
                                                 "-o",
                                                 "h.npz"});
    CHECK(query.job.scene == "forest");
    REQUIRE(query.rays.size() == 2);
    CHECK(query.rays[0][3] == 0);
    CHECK(std::isinf(query.rays[0][7]));
    CHECK(query.rays[1] == WorldRay{-1, -2, -3, 0.5, 0, 1, 0, 9});
    CHECK(query.kind == "multi");
    CHECK(query.max_hits == 4);
    CHECK(query.fields == std::vector<std::string>{"t", "path"});
    CHECK(query.job.settings == std::vector<std::string>{"cutoff=0.3", "cull=back"});
    CHECK(query.job.mask == 0xFF);
    CHECK(query.job.deadline == 2.5);
    CHECK(query.output == "h.npz");
    CHECK_FALSE(query.from);
    const auto fan =
        options_of<QueryOptions>({"query", "forest", "--from", "1,-2,3", "--rays", "d.npy"});
    CHECK(fan.rays_file == "d.npy");
    CHECK(fan.from == WorldPoint{1, -2, 3});

    const auto render =
        options_of<RenderOptions>({"render", "f", "-o", "h.npy", "--lookat", "1,2,3,0,0,0", "--fov",
                                   "30", "--size", "320x200", "--integrator", "ao"});
    CHECK(render.camera.look_at.size() == 6);
    CHECK(render.camera.width == 320);
    CHECK(render.camera.height == 200);
    CHECK(render.integrator == "ao");

    const auto heatmap =
        request_of<wire::Heatmap>({"heatmap", "f", "-o", "h.npy", "--size", "320x200", "--metric",
                                   "nodes", "--range", "0:40"});
    CHECK(heatmap->job->scene == "f");
    CHECK(heatmap->width == 320);
    CHECK(heatmap->height == 200);
    CHECK(heatmap->metric == "nodes");
    CHECK(heatmap->range == "0:40");

    const auto load = request_of<wire::Load>(
        {"load", "root:a.npy", "--build", "high", "--unit", "mm", "--replace"});
    CHECK(load->source == "root:a.npy");
    CHECK(load->build == "high");
    CHECK(load->unit == 0.001);
    CHECK(load->replace);
    CHECK(load->origin_x == 0);
    const auto far =
        request_of<wire::Load>({"load", "root:a.glb", "--origin", "500000.015625,4500000,-1"});
    CHECK(far->origin_x == 500'000.015625);
    CHECK(far->origin_y == 4'500'000);
    CHECK(far->origin_z == -1);
    CHECK_FALSE(far->replace);
    const auto moved = parse({"query", "f", "--rays", "a.npy", "--origin", "1,2,3"});
    REQUIRE_FALSE(moved);
    CHECK(moved.error().message.find("--from") != std::string::npos);
    CHECK(request_of<wire::Path>({"path", "f", "birch-17/leaves"})->text == "birch-17/leaves");
}

TEST_CASE("global options stand before or after the subcommand") {
    for (const auto& words : {std::vector<std::string>{"--json", "--server", "unix:x", "scenes"},
                              std::vector<std::string>{"scenes", "--server", "unix:x", "--json"}}) {
        const auto parsed = parse(words);
        REQUIRE(parsed);
        CHECK(parsed->options->json);
        CHECK(parsed->options->server == "unix:x");
    }
}

TEST_CASE("a private daemon is for commands that bring their scene and wait for their answer") {
    const auto parsed = parse({"--local", "info", "a.glb"});
    REQUIRE(parsed);
    CHECK(parsed->options->local);
    CHECK(parse({"variants", "--local"}));
    CHECK(complaint({"--local", "info", "forest"}).find("forest.glb") != std::string::npos);
    CHECK(complaint({"--local", "render", "a.glb", "--detach"}).find("--detach") !=
          std::string::npos);
    CHECK(complaint({"--local", "top"}).find("raynestd") != std::string::npos);
}

TEST_CASE("mistakes are usage errors in one line") {
    const std::vector<std::string> lines = {"nonsense",
                                            "load",
                                            "scenes extra",
                                            "query f",
                                            "query f --ray 1,2,3",
                                            "query f --ray 1,2,3,4,5,six",
                                            "query f --ray 1,2,3,4,5,6,",
                                            "query f --rays a --ray 1,2,3,4,5,6",
                                            "query f --rays a --from 1,2",
                                            "query f --ray 1,2,3,4,5,6 --from 1,2,3",
                                            "query f --ray 1,2,3,4,5,6 --max-hits 0",
                                            "query f --ray 1,2,3,4,5,6 --max-hits 4",
                                            "query f --ray 1,2,3,4,5,6 --kind any --max-hits 4",
                                            "query f --ray 1,2,3,4,5,6 --epoch 0",
                                            "query f --ray 1,2,3,4,5,6 -o hits.txt",
                                            "render f",
                                            "render f -o x.gif",
                                            "render f -o .png",
                                            "render f -o x.png --size 10",
                                            "render f -o x.png --size 0x10",
                                            "render f -o x.png --size 10x20x30",
                                            "render f -o x.png --fov 180",
                                            "render f -o x.png --lookat 1,2,3",
                                            "render f -o x.png --camera a --lookat 1,2,3,4,5,6",
                                            "render f -o x.png --mask xyz",
                                            "render f -o x.png --mask 123456789",
                                            "render f -o x.png --deadline 0",
                                            "render f -o x.png --spp 0",
                                            "heatmap f -o x.jpg",
                                            "path f"};
    for (const std::string& line : lines) {
        CAPTURE(line);
        CHECK(complaint(words_of(line)).find('\n') == std::string::npos);
    }
    for (const char* option : {"--metric", "--range", "--worker", "--intersector"}) {
        CAPTURE(option);
        CHECK(complaint({"heatmap", "f", "-o", "x.png", option, ""}).find("must not be empty") !=
              std::string::npos);
    }
    CHECK(complaint({"--dask", "", "info", "f"}).find("--dask: must not be empty") !=
          std::string::npos);
}

TEST_CASE("a complaint names the wrong word and the accepted ones") {
    const auto says = [](const std::string& line, const std::string& part) {
        CAPTURE(line);
        const std::string message = complaint(words_of(line));
        CAPTURE(message);
        CHECK(message.size() < 300);
        CHECK(message.find(part) != std::string::npos);
    };
    for (const std::string line : {"rendr", "rendr --help", "rendr forest -o x.png"})
        says(line, "no subcommand 'rendr'; there are load, scenes");
    says("--jason --help", "no option --jason");
    says("query f --rayz a.npy", "no option --rayz");
    says("render f --sise 8x8", "no option --sise");
    says("path f 9 --epoch 0", "'0' is not a whole number from 1 to 18446744073709551615");
    says("path f 9 --epoch 99999999999999999999", "'99999999999999999999' is not a whole number");
    says("render f -o x.png --seed 0.5", "'0.5' is not a whole number");
    says("render f -o x.png --spp 65537", "a whole number from 1 to 65536");
    says("render f -o x.png --deadline nan", "'nan' is not a number of seconds from 0.001");
    says("query f --ray 1e300,0,0,0,0,1", "'1e300' does not fit a 32-bit float");
    // Eight numbers with tmin and tmax at the end, where that shows.
    for (const char* old :
         {"0,0,5,-1,0,0,0,9", "0,0,5,2,0,0,1,1", "0,0,5,nan,0,0,1,1", "0,0,5,1,0,0,0,9"})
        for (const std::string command : {"query f --ray ", "explain f --ray "})
            says(command + old, "they are ox,oy,oz,tmin,dx,dy,dz,tmax");
    const std::string query = "query f --ray 0,0,0,0,0,1 ";
    says(query + "--set cutoff=1 --set cutoff=2", "'cutoff' is set twice");
    says(query + "--set cutoff", "'cutoff' is not name=value");
    says(query + "--fields t,prim,t", "'t' is named twice");
    says(query + "--fields t,,prim", "empty name");
}

TEST_CASE("the bare command prints the first command to type") {
    for (const char* line : {"", "--quiet"}) {
        const std::string message = complaint(words_of(line));
        CHECK(message.find("\n  raynest load builtin:forest\n") != std::string::npos);
        CHECK(message.find("raynest --help") != std::string::npos);
    }
}

TEST_CASE("empty texts are refused where a name belongs") {
    for (const auto& words : {std::vector<std::string>{"load", ""},
                              {"load", "a.glb", "--name", ""},
                              {"query", "f", "--ray", "0,0,0,0,0,1", "--fields", ""}}) {
        CHECK(complaint(words).find("empty") != std::string::npos);
    }
}

TEST_CASE("help begins with something to type") {
    for (const auto& [words, start] :
         {std::pair{std::vector<std::string>{"--help"}, "Example:\n  raynest load forest.glb\n"},
          std::pair{std::vector<std::string>{"heatmap", "--help"},
                    "Example:\n  raynest heatmap forest -o cost.png\n"}}) {
        const auto parsed = parse(words);
        REQUIRE(parsed);
        CHECK(!parsed->options);
        CHECK(parsed->text.rfind(start, 0) == 0);
    }
    CHECK(parse({"--version"})->text.rfind("raynest ", 0) == 0);
}

TEST_CASE("a detached request needs no file, an attached one does") {
    CHECK(options_of<RenderOptions>(words_of("render forest --detach")).job.detach);
    CHECK(request_of<wire::Heatmap>(words_of("heatmap forest --detach -o a.npy"))->job->detach);
    CHECK(
        options_of<QueryOptions>(words_of("query forest --ray 0,1,5,0,0,-1 --detach")).job.detach);
    CHECK_FALSE(options_of<RenderOptions>(words_of("render forest -o a.png")).job.detach);
    CHECK(complaint(words_of("render forest")).find("--output") != std::string::npos);
    CHECK(complaint(words_of("heatmap forest")).find("--output") != std::string::npos);
    CHECK(complaint(words_of("load forest --detach")).find("--detach") != std::string::npos);
}

TEST_CASE("jobs are named by whole numbers from 1") {
    CHECK(request_of<wire::Wait>(words_of("wait 17"))->job == 17);
    CHECK(request_of<wire::CancelJob>(words_of("cancel 17"))->job == 17);
    CHECK(command_of(words_of("fetch 17 -o hits.npz")));
    for (const char* line :
         {"wait", "wait 0", "wait -1", "fetch x", "cancel 1.5", "fetch 1 -o a.jpg"})
        CHECK_MESSAGE(!complaint(words_of(line)).empty(), line);
}
