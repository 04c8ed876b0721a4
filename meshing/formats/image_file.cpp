// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/image_file.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <ImfStdIO.h>
#include <fmt/format.h>
#include <png.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <new>
#include <set>
#include <system_error>

#include "meshing/core/error.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/untrusted_file.h"

namespace shellgrid {
namespace {

constexpr std::uint64_t most_samples = std::uint64_t{1} << 28;

// A file in memory, for OpenEXR.
class MemoryInput : public Imf::IStream {
 public:
  MemoryInput(const std::string& path, const std::string& bytes) : Imf::IStream(path.c_str()), bytes_(bytes) {}
  bool read(char to[], int count) override {
    if (count < 0 || static_cast<std::size_t>(count) > bytes_.size() - position_)
      throw InputError(std::string(fileName()) + ": truncated EXR file");
    std::memcpy(to, bytes_.data() + position_, static_cast<std::size_t>(count));
    position_ += static_cast<std::size_t>(count);
    return position_ < bytes_.size();
  }
  uint64_t tellg() override { return position_; }
  void seekg(uint64_t position) override { position_ = std::min<std::size_t>(position, bytes_.size()); }

 private:
  const std::string& bytes_;
  std::size_t position_ = 0;
};

Image parse_exr(const std::string& path, const std::string& bytes) {
  MemoryInput stream(path, bytes);
  Imf::InputFile file(stream, 0);
  const Imath::Box2i window = file.header().dataWindow();
  const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1;
  const std::int64_t height = std::int64_t{window.max.y} - window.min.y + 1;
  std::uint64_t channels = 0;
  for (auto it = file.header().channels().begin(); it != file.header().channels().end(); ++it) {
    ++channels;
    if (it.channel().xSampling != 1 || it.channel().ySampling != 1)
      throw InputError(fmt::format("{}: channel {} is subsampled, which is not supported", path, it.name()));
  }
  if (width <= 0 || height <= 0 || channels == 0) throw InputError(path + ": the picture is empty");
  // No codec of the format packs a pixel row of one block into less than a few bytes.
  const std::uint64_t samples = static_cast<std::uint64_t>(width) * static_cast<std::uint64_t>(height) * channels;
  if (width > (1 << 20) || height > (1 << 20) || samples > most_samples || samples / 8192 > bytes.size())
    throw InputError(fmt::format("{}: the header promises {}×{} pixels of {} channels, too many for a file of {} bytes",
                                 path, width, height, channels, bytes.size()));
  Image image;
  image.width = static_cast<int>(width);
  image.height = static_cast<int>(height);
  image.channels.reserve(channels);
  Imf::FrameBuffer frame;
  for (auto it = file.header().channels().begin(); it != file.header().channels().end(); ++it) {
    Image::Channel& channel = image.add(it.name());
    frame.insert(it.name(), Imf::Slice::Make(Imf::FLOAT, channel.values.data(), window, sizeof(float),
                                             sizeof(float) * static_cast<std::size_t>(width)));
  }
  file.setFrameBuffer(frame);
  file.readPixels(window.min.y, window.max.y);
  return image;
}

std::string encode_exr(const std::string& path, const Image& image) {
  Imf::Header header(image.width, image.height);
  header.compression() = Imf::ZIP_COMPRESSION;
  header.zipCompressionLevel() = 1;  // faster than the default, 1 % larger
  Imf::FrameBuffer frame;
  std::set<std::string> names;
  for (const Image::Channel& channel : image.channels) {
    if (channel.name.empty() || channel.name.size() > 31 || !names.insert(channel.name).second ||
        channel.values.size() != static_cast<std::size_t>(image.width) * image.height)
      throw InternalError(fmt::format("{}: channel '{}' cannot be written", path, channel.name));
    header.channels().insert(channel.name, Imf::Channel(Imf::FLOAT));
    // OpenEXR takes a mutable pointer but only reads.
    frame.insert(channel.name,
                 Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(const_cast<float*>(channel.values.data())),
                            sizeof(float), sizeof(float) * static_cast<std::size_t>(image.width)));
  }
  Imf::StdOSStream stream;
  {
    Imf::OutputFile file(stream, header, 0);
    file.setFrameBuffer(frame);
    file.writePixels(image.height);
  }
  return stream.str();
}

float srgb_to_linear(float value) {
  return value <= 0.04045f ? value / 12.92f : std::pow((value + 0.055f) / 1.055f, 2.4f);
}

// The header of a PNG file in memory, its size believable. To be finished or freed.
png_image open_png(const std::string& path, const std::string& bytes) {
  if (bytes.empty()) throw InputError(path + ": the file is empty");
  png_image header{};
  header.version = PNG_IMAGE_VERSION;
  if (!png_image_begin_read_from_memory(&header, bytes.data(), bytes.size()))
    throw InputError(fmt::format("{}: not a readable PNG file: {}", path, one_line(header.message)));
  const std::uint64_t samples = std::uint64_t{3} * header.width * header.height;
  // Deflate packs at most 1032 to 1, and a pixel takes at least one bit.
  if (samples > most_samples || samples / (3 * 8 * 1032) > bytes.size()) {
    const std::string message = fmt::format("{}: the header promises {}×{} pixels, too many for a file of {} bytes",
                                            path, header.width, header.height, bytes.size());
    png_image_free(&header);
    throw InputError(message);
  }
  return header;
}

}  // namespace

Image read_exr(const std::string& path) {
  const std::string bytes = read_text(path);
  if (bytes.empty()) throw InputError(path + ": the file is empty");
  if (bytes.size() < 8 || bytes.compare(0, 4, "\x76\x2f\x31\x01") != 0) throw InputError(path + ": not an EXR file");
  try {
    return parse_exr(path, bytes);
  } catch (const InputError&) {
    throw;
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::exception& error) {
    throw InputError(fmt::format("{}: not a readable EXR file: {}", path, one_line(error.what())));
  }
}

void write_exr(const std::string& path, const Image& image) {
  if (image.width <= 0 || image.height <= 0 || image.channels.empty())
    throw InternalError(path + ": the image to write is empty");
  std::string bytes;
  try {
    bytes = encode_exr(path, image);
  } catch (const Iex::BaseExc& error) {
    throw InternalError(fmt::format("{}: OpenEXR: {}", path, one_line(error.what())));
  }
  write_text_atomically(path, bytes);
}

void write_png(const std::string& path, int width, int height, const std::vector<std::uint8_t>& rgb) {
  if (width <= 0 || height <= 0 || rgb.size() != std::size_t{3} * width * height)
    throw InternalError(fmt::format("{}: {} bytes for {}×{} pixels", path, rgb.size(), width, height));
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(width);
  image.height = static_cast<png_uint_32>(height);
  image.format = PNG_FORMAT_RGB;
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(image);
  std::string bytes(size, '\0');
  if (!png_image_write_to_memory(&image, bytes.data(), &size, 0, rgb.data(), 0, nullptr))
    throw InternalError(fmt::format("{}: libpng: {}", path, image.message));
  bytes.resize(size);
  write_text_atomically(path, bytes);
}

Image read_png(const std::string& path) {
  const std::string bytes = read_text(path);
  png_image header = open_png(path, bytes);
  header.format = PNG_FORMAT_RGB;
  const std::size_t samples = std::size_t{3} * header.width * header.height;
  std::vector<std::uint8_t> rgb(samples);
  const png_color black{0, 0, 0};
  if (!png_image_finish_read(&header, &black, rgb.data(), 0, nullptr))
    throw InputError(fmt::format("{}: not a readable PNG file: {}", path, one_line(header.message)));
  Image image;
  image.width = static_cast<int>(header.width);
  image.height = static_cast<int>(header.height);
  std::array<float, 256> linear;
  for (int v = 0; v < 256; ++v) linear[static_cast<std::size_t>(v)] = srgb_to_linear(static_cast<float>(v) / 255.0f);
  for (int c = 0; c < 3; ++c) {
    Image::Channel& channel = image.add(std::string(1, "RGB"[c]));
    for (std::size_t i = 0; i < channel.values.size(); ++i)
      channel.values[i] = linear[rgb[3 * i + static_cast<std::size_t>(c)]];
  }
  return image;
}

Image read_grey_png(const std::string& path) {
  const std::string bytes = read_text(path);
  png_image header = open_png(path, bytes);
  const bool wide = (header.format & PNG_FORMAT_FLAG_LINEAR) != 0;
  header.format = wide ? PNG_FORMAT_LINEAR_Y : PNG_FORMAT_GRAY;
  const std::size_t samples = std::size_t{1} * header.width * header.height;
  std::vector<std::uint8_t> narrow_values(wide ? 0 : samples);
  std::vector<std::uint16_t> wide_values(wide ? samples : 0);
  void* values = wide ? static_cast<void*>(wide_values.data()) : narrow_values.data();
  const png_color black{0, 0, 0};
  if (!png_image_finish_read(&header, &black, values, 0, nullptr))
    throw InputError(fmt::format("{}: not a readable PNG file: {}", path, one_line(header.message)));
  Image image;
  image.width = static_cast<int>(header.width);
  image.height = static_cast<int>(header.height);
  Image::Channel& channel = image.add("Y");
  for (std::size_t i = 0; i < samples; ++i)
    channel.values[i] =
        wide ? static_cast<float>(wide_values[i]) / 65535.0f : static_cast<float>(narrow_values[i]) / 255.0f;
  return image;
}

}  // namespace shellgrid
