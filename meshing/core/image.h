// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstddef>
#include <string>
#include <vector>

namespace shellgrid {

// Named layers of one picture size, as an EXR file holds them. Row 0 is the top; within a channel
// pixels are stored row by row. Channel names are EXR's: "R", "specular.R", "depth.Z", "normal.X".
struct Image {
  struct Channel {
    std::string name;
    std::vector<float> values;  // width·height
  };
  int width = 0;
  int height = 0;
  std::vector<Channel> channels;

  Channel& add(const std::string& name) {
    channels.push_back({name, std::vector<float>(static_cast<std::size_t>(width) * height, 0.0f)});
    return channels.back();
  }
  const Channel* find(const std::string& name) const {
    for (const Channel& channel : channels)
      if (channel.name == name) return &channel;
    return nullptr;
  }
};

}  // namespace shellgrid
