// raynest merge OUT PARTS...: joins the files of --part, by the Python package.
#include "client/commands/commands.h"
#include "client/ground/python.h"

namespace raynest::client {

void declare(CommandLine& line, MergeOptions& merge) {
    line.add_option(
            "OUT", merge.output,
            "FILE.npz, FILE.png or FILE.exr that the parts become; parts in .npz with the column "
            "position also become FILE.ply, .pcd or .las")
        .required();
    line.add_options("PART", merge.parts, "files that --part has written, in any order");
}

Failure become_merge(const MergeOptions& options, bool json) {
    std::vector<std::string> words = {options.output};
    if (json) words.insert(words.begin(), "--json");
    words.insert(words.end(), options.parts.begin(), options.parts.end());
    return become_python("raynest.merge", std::move(words));
}

Result<void> run(Context& context, const MergeOptions& options) {
    return tl::unexpected<Failure>(become_merge(options, context.json));
}

}  // namespace raynest::client
