// Integrators: how light arrives at a camera. Each is a class in a header of its own and a row of
// integrators.def; nothing else names it.
//
//     class Ao final : public Integrator {
//     public:
//         Ao(const IntegratorScene& scene, const IntegratorSettings& settings);
//         bool render(...) const override;
//     };
//
// An integrator works in wavefronts: arrays of rays, cast by a RayCaster. It sees no worker, no
// intersector and no chunk. A sample depends on the scene, the settings, the seed, its pixel and
// its number alone, so that a picture has the same bytes however it was cut into calls; the film
// adds samples in the order of their numbers (film.h).
#pragma once

#include "engine/geometry/box.h"
#include "engine/integrators/film.h"
#include "engine/integrators/generators.h"
#include "engine/integrators/ray_caster.h"
#include "engine/math/sampler.h"
#include "engine/queries/columns.h"
#include "engine/result.h"
#include "engine/shading/records.h"

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest {

/// A picture of the surroundings, all around: linear RGB, row 0 on top. Its middle lies at +X and
/// its right half towards +Z, as three.js and Cycles place it.
struct EnvironmentPicture {
    ImageSize size;
    std::vector<Vec3> pixels;
    std::uint32_t left_out = 0;  ///< pixels that the decoder took for none and made black
};

struct IntegratorSettings {
#define RAYNEST_INTEGRATOR_SETTING(name, type, option, label, least, most, initial, ...) \
    type name = initial;
#include "engine/integrators/integrator_settings.def"
    enum class Environment : std::uint8_t {
        automatic,  ///< sky, unless the scene has lights of KHR_lights_punctual
        sky,
        none,
        picture
    } environment = Environment::automatic;
    std::shared_ptr<const EnvironmentPicture> picture = nullptr;  ///< for Environment::picture
    float environment_rotate =
        0;                    ///< degrees from the north eastwards by which the picture is turned
    bool sun = false;         ///< the two angles count
    float sun_azimuth = 0;    ///< degrees from the north (UpAxis), eastwards
    float sun_elevation = 0;  ///< degrees above the horizon
};

/// The scene of a job; all it points to outlives the integrator.
struct IntegratorScene {
    ColumnSource source;                   ///< without rays and hits
    Box bounds;                            ///< the scene's box
    const ShadingView* shading = nullptr;  ///< null: base colours are all that is known
    /// The CPU target whose code shades (integrators/target_module.h); "": the baseline's.
    std::string_view target = {};
    /// The scene as rays see it: the same in other records, in which some instances have the mask 0
    /// and some objects no primitives (scene/selection). Null: that of `source`.
    const SceneView* seen = nullptr;
    std::uint32_t mask = ~0U;  ///< the rays' mask: what they cannot enter gives no light
    [[nodiscard]] const SceneView& view() const { return *source.scene; }
};

/// Samples to make: `sample_count` of each of `pixel_count` pixels.
struct SampleRange {
    const Sensor& camera;
    std::uint64_t first_pixel = 0;  ///< in the tile order of the window
    std::uint64_t pixel_count = 0;
    std::uint32_t first_sample = 0;
    std::uint32_t sample_count = 1;
    std::uint64_t seed = 0;
    PixelWindow window = {};  ///< that the film holds

    /// Sample s of pixel p is number p * sample_count + s of all arrays.
    [[nodiscard]] std::uint64_t samples() const { return pixel_count * sample_count; }
};

/// More memory of one integrator.
struct IntegratorMemory {
    IntegratorMemory() = default;
    IntegratorMemory(const IntegratorMemory&) = delete;
    IntegratorMemory& operator=(const IntegratorMemory&) = delete;
    virtual ~IntegratorMemory() = default;
};

/// Arrays to work in, kept between calls for their memory. Integrators size them as they need;
/// nothing in them survives a call.
struct Wavefront {
    std::vector<std::uint64_t> pixels;  ///< index of each pixel in the whole picture, row by row
    std::vector<Ray> rays;
    std::vector<HitRecord> hits;
    std::vector<Ray> shadow_rays;
    std::vector<std::uint8_t> occluded;
    std::vector<FilmSample> samples;
    std::unique_ptr<IntegratorMemory> memory;  ///< made by the integrator that last used it
};

class Integrator {
public:
    Integrator() = default;
    Integrator(const Integrator&) = delete;
    Integrator& operator=(const Integrator&) = delete;
    virtual ~Integrator() = default;

    /// Makes all samples of a range: out[i] for number i, default-constructed before the call.
    /// False where the caster had no answers. Any thread.
    [[nodiscard]] virtual bool render(const SampleRange& range, RayCaster& caster,
                                      Wavefront& arrays, std::span<FilmSample> out) const = 0;
    /// Lines for the user, e.g. that a scene without lights got the sky.
    [[nodiscard]] virtual std::vector<std::string> notes() const { return {}; }
    /// Rays of one sample at most, roughly: chunks with more are cut smaller.
    [[nodiscard]] virtual std::uint32_t rays_per_sample() const { return 2; }
    /// See add_samples(). Virtual, so that it is compiled for the target of the integrator.
    [[nodiscard]] virtual bool add(const SampleRange& range, RayCaster& caster, Wavefront& arrays,
                                   Film& film) const;
};

/// An integrator of the list, compiled for the scene's target where there is a module for it; may
/// take long where it has to look at all lights. Fails with param_invalid, naming the setting, or
/// with pack_invalid where the module is of another build.
Result<std::unique_ptr<const Integrator>> make_integrator(std::string_view name,
                                                          const IntegratorScene& scene,
                                                          const IntegratorSettings& settings);

struct IntegratorInfo {
    std::string_view name;
    std::string_view text;                     ///< what it shows, for users
    bool lit;                                  ///< false if 1 means white
    std::array<std::string_view, 8> settings;  ///< that it reads, of Render; "" behind the last
};
[[nodiscard]] std::span<const IntegratorInfo> integrator_table();
/// Their names: "ao, direct, path".
[[nodiscard]] std::string integrator_names();

/// Makes the samples of a range and adds them to a film of the window's size. False where the
/// caster had no answers: then the film is as before.
[[nodiscard]] inline bool add_samples(const Integrator& integrator, const SampleRange& range,
                                      RayCaster& caster, Wavefront& arrays, Film& film) {
    return integrator.add(range, caster, arrays, film);
}

// ---- parts that integrators share -------------------------------------------------------------

/// Fills arrays.pixels and arrays.rays with the camera rays of a range, each through a random point
/// of its pixel, and arrays.hits with what they meet. False where the caster had no answers.
[[nodiscard]] bool cast_camera_rays(const SampleRange& range, RayCaster& caster, Wavefront& arrays);

/// The random numbers of number i of the range; arrays.pixels must be set.
[[nodiscard]] inline Sampler sampler_of(const SampleRange& range, const Wavefront& arrays,
                                        std::size_t i) {
    return {range.seed, arrays.pixels[i / range.sample_count],
            range.first_sample + static_cast<std::uint32_t>(i % range.sample_count)};
}

/// Writes what the first hit alone says: alpha, normal, depth, position and ids.
void describe_first_hit(const ColumnSource& scene, const Ray& ray, const HitRecord& hit,
                        FilmSample& sample);

/// A direction around a unit normal, cosine-weighted, from two numbers in [0, 1).
[[nodiscard]] Vec3 cosine_direction(const Vec3& normal, const Vec2& random);

}  // namespace raynest
