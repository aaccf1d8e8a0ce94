#include "tests/cuda/gpu/device_pack.h"

#include <dlfcn.h>

#include <algorithm>
#include <iterator>
#include <span>

namespace raynest::bench {
namespace {

template <class Entry>
Entry find_symbol(const std::string& path, const char* name) {
    void* const module = ::dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (module == nullptr) throw std::runtime_error(::dlerror());
    const auto entry = reinterpret_cast<Entry>(::dlsym(module, name));
    if (entry == nullptr) throw std::runtime_error(path + " has no " + name);
    return entry;
}

}  // namespace

const Pack& open_pack(const std::string& path) {
    const Pack& pack = *find_symbol<PackEntry>(path, pack_symbol)();
    const std::uint32_t sizes[] = {sizeof(SceneView), sizeof(ObjectRecord), sizeof(HitRecord),
                                   sizeof(TraceCall)};
    if (pack.abi != pack_abi || !std::equal(std::begin(sizes), std::end(sizes), pack.sizes))
        throw std::runtime_error(path + " was built against other engine headers: rebuild it");
    return pack;
}

const PackVariant* find_variant(const Pack& pack, const std::string& name) {
    for (const PackVariant& variant : std::span(pack.variants, pack.variant_count)) {
        if (variant.name == name) return &variant;
    }
    return nullptr;
}

DevicePack::DevicePack(const std::string& path)
    : pack_(open_pack(path)),
      device_(find_symbol<DeviceEntry>(path, device_symbol)()) {
    if (device_->abi != device_abi)
        throw std::runtime_error(path + " was built against other engine headers: rebuild it");
    if (device_->open(&info_) != trace_ok) throw NoDevice(device_->error());
}

DevicePack::Scene DevicePack::load(const SceneView& view) const {
    DeviceScene* scene = nullptr;
    const TraceStatus status = device_->load(&view, &scene);
    if (status == trace_too_deep)
        throw std::runtime_error("the scene has more levels than the device's kernels take");
    expect_ok(status, "copying the scene");
    return {scene, device_->unload};
}

DevicePack::Slot DevicePack::make_slot(std::uint64_t rays, std::uint64_t hits) const {
    DeviceSlot* slot = nullptr;
    expect_ok(device_->make_slot(rays, hits, &slot), "making a slot");
    return {slot, device_->free_slot};
}

void DevicePack::pin(void* memory, std::uint64_t bytes) const {
    expect_ok(device_->pin(memory, bytes), "pinning memory");
}

void DevicePack::start(const Slot& slot, const Scene& scene, TraceFunction kernel,
                       const TraceCall& call) const {
    expect_ok(device_->start(slot.get(), scene.get(), kernel, &call, nullptr), "starting a call");
}

double DevicePack::finish(const Slot& slot) const {
    double seconds = 0;
    expect_ok(device_->finish(slot.get()), "finishing a call");
    expect_ok(device_->kernel_seconds(slot.get(), &seconds), "timing a kernel");
    return seconds;
}

void DevicePack::expect_ok(TraceStatus status, const std::string& step) const {
    if (status == trace_ok) return;
    if (status == trace_bad_call) throw std::runtime_error(step + ": the pack refuses the call");
    throw std::runtime_error(step + ": " + device_->error());
}

}  // namespace raynest::bench
