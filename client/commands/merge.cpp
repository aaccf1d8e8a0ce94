// raynest merge OUT PARTS...: joins the files of --part, by the Python package.
#include "client/commands/command.h"
#include "client/ground/python.h"
#include "client/net/local_daemon.h"

namespace raynest::client {
namespace {

struct MergeOptions {
    std::string output;
    std::vector<std::string> parts;
    std::vector<std::string> limits;  ///< of --fail-if
};

/// The program becomes the one that joins them, or this fails.
Failure become_merge(const MergeOptions& options, bool json) {
    name_daemon();  // it draws heat maps
    std::vector<std::string> words;
    if (json) words.emplace_back("--json");
    for (const std::string& limit : options.limits) {
        words.emplace_back("--fail-if");
        words.push_back(limit);
    }
    words.push_back(options.output);
    words.insert(words.end(), options.parts.begin(), options.parts.end());
    return become_python("raynest.merge", std::move(words));
}

}  // namespace

void declare(CommandLine& line, MergeOptions& merge) {
    line.add_option(
            "OUT", merge.output,
            "FILE.npz, FILE.png or FILE.exr that the parts become; parts in .npz with the column "
            "position also become FILE.ply, .pcd or .las, parts in .png or of heat maps "
            "FILE.npy, and parts of heat maps FILE.png")
        .required();
    line.add_options("PART", merge.parts, "files that --part has written, in any order");
    line.add_each(
        "--fail-if",
        [&merge](const std::string& text) -> Result<void> {
            merge.limits.push_back(text);
            return {};
        },
        "of a heat map, 'METRIC[.LEVEL].STATISTIC OP NUMBER' as heatmap takes it: end with exit "
        "code 9 if that is true; may be repeated");
}

Result<void> run(Context& context, const MergeOptions& options) {
    return tl::unexpected<Failure>(become_merge(options, context.json));
}

namespace {

class Merge final : public CommandOf<MergeOptions> {
    [[nodiscard]] std::optional<Result<void>> run_alone(const std::string& /*uri*/,
                                                        bool json) const override {
        return tl::unexpected<Failure>(become_merge(options_, json));
    }
};

}  // namespace

std::unique_ptr<Command> make_merge() {
    return std::make_unique<Merge>();
}

}  // namespace raynest::client
