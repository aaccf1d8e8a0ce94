// The Embree peer's one exported symbol: what the library says of itself, its forms, its builds.
#include "tests/bench/clock.h"
#include "tests/bench/embree/forms.h"

#include <dlfcn.h>
#include <malloc.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <fstream>
#include <string>

namespace raynest::bench {
namespace {

std::uint64_t resident_bytes() {
    std::ifstream file("/proc/self/statm");
    std::uint64_t total = 0;
    std::uint64_t resident = 0;
    file >> total >> resident;
    return resident * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
}

/// Captures the standard output of `work`: Embree's log goes nowhere else.
template <class Work>
std::string captured(Work&& work) {
    std::fflush(stdout);
    const int saved = dup(STDOUT_FILENO);
    const int file = memfd_create("log", 0);
    dup2(file, STDOUT_FILENO);
    work();
    std::fflush(stdout);
    dup2(saved, STDOUT_FILENO);
    close(saved);
    std::string text(static_cast<std::size_t>(lseek(file, 0, SEEK_CUR)), '\0');
    const ssize_t got = pread(file, text.data(), text.size(), 0);
    close(file);
    text.resize(static_cast<std::size_t>(std::max<ssize_t>(got, 0)));
    return text;
}

/// The log of a device that builds a tree of a few triangles.
std::string verbose_log() {
    return captured([] {
        const std::string options = device_options + std::string("1,verbose=2");
        RTCDevice device = rtcNewDevice(options.c_str());
        RTCScene scene = rtcNewScene(device);
        RTCGeometry mesh = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        constexpr std::uint32_t count = 64;
        auto* vertex = static_cast<float*>(rtcSetNewGeometryBuffer(
            mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, 3 * count));
        auto* index = static_cast<std::uint32_t*>(
            rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, count));
        for (std::uint32_t i = 0; i < 9 * count; ++i) vertex[i] = static_cast<float>(i * 37 % 101);
        for (std::uint32_t i = 0; i < 3 * count; ++i) index[i] = i;
        rtcCommitGeometry(mesh);
        rtcAttachGeometry(scene, mesh);
        rtcReleaseGeometry(mesh);
        rtcCommitScene(scene);
        rtcReleaseScene(scene);
        rtcReleaseDevice(device);
    });
}

/// Returns the text between `from` and `to` behind `after`, trimmed; "?" if the log has no such
/// text.
std::string logged(const std::string& log, const std::string& after, const std::string& from,
                   const std::string& to) {
    const std::size_t start = log.find(from, std::min(log.find(after), log.size()));
    const std::size_t end = log.find(to, start);
    if (start == std::string::npos || end == std::string::npos) return "?";
    const std::size_t first = log.find_first_not_of(" :", start + from.size());
    const std::size_t last = log.find_last_not_of(" .", end - 1);
    return log.substr(first, last + 1 - first);
}

/// A library with live asserts imports what a failed one calls.
bool asserts_live() {
    Dl_info info{};
    if (dladdr(reinterpret_cast<void*>(&rtcNewDevice), &info) == 0) return false;
    std::ifstream file(info.dli_fname, std::ios::binary | std::ios::ate);
    std::string bytes(file ? static_cast<std::size_t>(file.tellg()) : 0, '\0');
    file.seekg(0);
    file.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    return bytes.find("__assert_fail") != std::string::npos;
}

class Embree final : public PeerLibrary {
public:
    Embree() : asserts_(asserts_live()) {
        const std::string log = verbose_log();
        const std::string targets = logged(log, "Config", "Targets", "(supported)");
        about_ = "Embree " RTC_VERSION_STRING ", " + targets.substr(targets.find_last_of(' ') + 1) +
                 ", " + logged(log, "Config", "building ", "using") + ", asserts " +
                 (asserts_ ? "live" : "off");
    }

    [[nodiscard]] std::string name() const override { return "embree"; }
    [[nodiscard]] std::string about() const override { return about_; }

    [[nodiscard]] double assert_factor(Query query, bool packets) const override {
        if (!asserts_) return 1;
        return packets ? 1.10 : query == query_any ? 1.08 : 1.04;
    }

    [[nodiscard]] std::span<const PeerForm> forms() const override { return embree_forms(); }

    Result<std::unique_ptr<Peer>> open(const PeerForm& form, Query query,
                                       const SceneView& view) override {
        return open_embree(trees_, form, query, view);
    }

    Result<PeerBuild> build(const SceneView& view, BuildQuality quality,
                            unsigned threads) override {
        constexpr std::array<RTCBuildQuality, 3> qualities{
            RTC_BUILD_QUALITY_LOW, RTC_BUILD_QUALITY_MEDIUM, RTC_BUILD_QUALITY_HIGH};
        TreeForm form;
        form.quality = qualities[static_cast<std::size_t>(quality)];
        auto tree = EmbreeTree::make(view, form, threads);
        if (!tree) return tl::unexpected(tree.error());
        const double wall = seconds_of(CLOCK_MONOTONIC);
        const double cpu = seconds_of(CLOCK_PROCESS_CPUTIME_ID);
        (*tree)->commit();
        return PeerBuild{seconds_of(CLOCK_MONOTONIC) - wall,
                         seconds_of(CLOCK_PROCESS_CPUTIME_ID) - cpu};
    }

    Result<PeerMemory> weigh(const SceneView& view) override {
        TreeForm form;
        form.instances = false;
        malloc_trim(0);  // else what was freed before hides what is allocated now
        const std::uint64_t before = resident_bytes();
        auto bare = EmbreeTree::make(view, form, 1);
        if (!bare) return tl::unexpected(bare.error());
        const std::uint64_t made = resident_bytes();
        const std::int64_t reported = (*bare)->reported_bytes();
        (*bare)->commit();
        const std::uint64_t committed = resident_bytes();
        PeerMemory memory{committed - made, (*bare)->reported_bytes() - reported, 0};
        if (view.objects[view.root].instance_count != 0) {
            form.instances = true;
            auto whole = EmbreeTree::make(view, form, 1);
            if (!whole) return tl::unexpected(whole.error());
            (*whole)->commit();
            // The bare scene is still there: what it took is taken again, and then the instances.
            memory.instance_bytes = resident_bytes() - committed - (committed - before);
        }
        return memory;
    }

private:
    bool asserts_;
    std::string about_;
    EmbreeTrees trees_;
};

}  // namespace
}  // namespace raynest::bench

extern "C" [[gnu::visibility("default")]] raynest::bench::PeerLibrary* raynest_bench_peer() {
    return new raynest::bench::Embree;
}
