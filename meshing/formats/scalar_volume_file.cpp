// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/scalar_volume_file.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <map>
#include <optional>
#include <sstream>
#include <string_view>

#include "meshing/core/error.h"
#include "meshing/formats/image_file.h"
#include "meshing/formats/output_file.h"

namespace shellgrid {

std::size_t value_bytes(ScalarType type) {
  switch (type) {
    case ScalarType::int8:
    case ScalarType::uint8:
      return 1;
    case ScalarType::int16:
    case ScalarType::uint16:
      return 2;
    case ScalarType::int32:
    case ScalarType::uint32:
    case ScalarType::float32:
      return 4;
    default:
      return 8;
  }
}

namespace {

static_assert(std::endian::native == std::endian::little);

constexpr double most_values = 1 << 28;
// Deflate packs at most 1032 to 1.
constexpr std::size_t most_deflation = 1032;

template <class T>
float value_as(const char* bytes, bool swap) {
  char copy[sizeof(T)];
  std::memcpy(copy, bytes, sizeof(T));
  if (swap) std::reverse(copy, copy + sizeof(T));
  T value;
  std::memcpy(&value, copy, sizeof(T));
  if constexpr (std::is_same_v<T, double>)
    // Beyond single precision is as good as infinite.
    return std::abs(value) > 3e38 ? static_cast<float>(INFINITY) : static_cast<float>(value);
  return static_cast<float>(value);
}

float decode(const char* bytes, ScalarType type, bool swap) {
  switch (type) {
    case ScalarType::int8:
      return value_as<std::int8_t>(bytes, swap);
    case ScalarType::uint8:
      return value_as<std::uint8_t>(bytes, swap);
    case ScalarType::int16:
      return value_as<std::int16_t>(bytes, swap);
    case ScalarType::uint16:
      return value_as<std::uint16_t>(bytes, swap);
    case ScalarType::int32:
      return value_as<std::int32_t>(bytes, swap);
    case ScalarType::uint32:
      return value_as<std::uint32_t>(bytes, swap);
    case ScalarType::int64:
      return value_as<std::int64_t>(bytes, swap);
    case ScalarType::uint64:
      return value_as<std::uint64_t>(bytes, swap);
    case ScalarType::float32:
      return value_as<float>(bytes, swap);
    default:
      return value_as<double>(bytes, swap);
  }
}

void check_size(const Vec3i& size, const std::string& path) {
  if ((size.array() < 1).any() || size.cast<double>().prod() > most_values)
    throw InputError(fmt::format("{}: a volume of {} x {} x {} values is out of range; expected 1 to 2^28 in all", path,
                                 size.x(), size.y(), size.z()));
}

void check_finite(const ScalarVolume& volume, const std::string& path) {
  for (std::size_t i = 0; i < volume.values.size(); ++i) {
    if (std::isfinite(volume.values[i])) continue;
    const int x = static_cast<int>(i % volume.size.x()), y = static_cast<int>(i / volume.size.x() % volume.size.y());
    throw InputError(
        fmt::format("{}: the value at ({}, {}, {}) is not finite", path, x, y, i / volume.size.x() / volume.size.y()));
  }
}

ScalarVolume decode_volume(std::string_view bytes, const RawLayout& layout, const std::string& path) {
  ScalarVolume volume;
  volume.size = layout.size;
  const std::size_t step = value_bytes(layout.type);
  if (bytes.size() / step < volume.count())
    throw InputError(fmt::format("{}: holds {} bytes of values, {} x {} x {} values of {} bytes need {}", path,
                                 bytes.size(), volume.size.x(), volume.size.y(), volume.size.z(), step,
                                 volume.count() * step));
  volume.values.resize(volume.count());
  for (std::size_t i = 0; i < volume.values.size(); ++i)
    volume.values[i] = decode(bytes.data() + i * step, layout.type, layout.big_endian);
  check_finite(volume, path);
  return volume;
}

std::string inflate_gzip(std::string_view packed, std::size_t wanted, const std::string& path) {
  if (wanted / most_deflation > packed.size())
    throw InputError(fmt::format("{}: the header promises {} bytes of values, too many for {} packed ones", path,
                                 wanted, packed.size()));
  std::string bytes(wanted, '\0');
  z_stream stream{};
  if (inflateInit2(&stream, 15 + 32) != Z_OK) throw std::bad_alloc();
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(packed.data()));
  stream.avail_in = static_cast<uInt>(std::min<std::size_t>(packed.size(), 0xffffffffu));
  stream.next_out = reinterpret_cast<Bytef*>(bytes.data());
  stream.avail_out = static_cast<uInt>(std::min<std::size_t>(wanted, 0xffffffffu));
  int state = Z_OK;
  // A file may hold several streams one after another.
  while (stream.avail_out > 0 && (state = inflate(&stream, Z_NO_FLUSH)) != Z_DATA_ERROR) {
    if (state == Z_STREAM_END && stream.avail_in > 0 && stream.avail_out > 0) {
      if (inflateReset(&stream) != Z_OK) break;
    } else if (state != Z_OK) {
      break;
    }
  }
  const std::size_t missing = stream.avail_out;
  inflateEnd(&stream);
  if (missing > 0)
    throw InputError(fmt::format("{}: the packed values are {}, {} of {} bytes are missing", path,
                                 state == Z_DATA_ERROR ? "damaged" : "truncated", missing, wanted));
  return bytes;
}

// The header of an NRRD file.
struct NrrdHeader {
  std::map<std::string, std::string> fields;
  std::size_t end = 0;  // of the header, in bytes
};

std::string trimmed(std::string_view text) {
  const std::size_t first = text.find_first_not_of(" \t\r");
  if (first == std::string_view::npos) return {};
  return std::string(text.substr(first, text.find_last_not_of(" \t\r") - first + 1));
}

NrrdHeader parse_header(const std::string& bytes, const std::string& path) {
  if (!bytes.starts_with("NRRD000")) throw InputError(path + ": not an NRRD file");
  NrrdHeader header;
  std::size_t begin = 0;
  for (int line_number = 1;; ++line_number) {
    // A detached header ends where the file does.
    if (begin >= bytes.size()) {
      header.end = bytes.size();
      return header;
    }
    const std::size_t end = std::min(bytes.find('\n', begin), bytes.size());
    if (end - begin > 100000) throw InputError(fmt::format("{}: line {} of the header is too long", path, line_number));
    const std::string line = trimmed(std::string_view(bytes).substr(begin, end - begin));
    begin = end + 1;
    if (line.empty()) {
      header.end = std::min(begin, bytes.size());
      return header;
    }
    if (line_number == 1 || line[0] == '#') continue;
    const std::size_t colon = line.find(':');
    if (colon == std::string::npos)
      throw InputError(fmt::format("{}: line {} of the header is no field", path, line_number));
    if (colon + 1 < line.size() && line[colon + 1] == '=') continue;  // a key of the user's
    header.fields[line.substr(0, colon)] = trimmed(line.substr(colon + 1));
  }
}

std::vector<double> parse_numbers(const std::string& text, const std::string& field, const std::string& path) {
  std::vector<double> numbers;
  std::istringstream words(text);
  for (std::string word; words >> word;) {
    double value = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (error != std::errc() || end != word.data() + word.size())
      throw InputError(
          fmt::format("{}: the field '{}' holds '{}', which is no number", path, field, word.substr(0, 40)));
    numbers.push_back(value);
  }
  return numbers;
}

// The lengths of "(a,b,c) (d,e,f) (g,h,i)". How these lie in space is of no matter, but that they are perpendicular.
std::vector<double> direction_lengths(const std::string& text, const std::string& path) {
  std::vector<double> lengths;
  std::vector<std::vector<double>> directions;
  std::size_t at = 0;
  while ((at = text.find('(', at)) != std::string::npos) {
    const std::size_t end = text.find(')', at);
    if (end == std::string::npos) throw InputError(path + ": the field 'space directions' has an open bracket");
    std::string inside = text.substr(at + 1, end - at - 1);
    std::replace(inside.begin(), inside.end(), ',', ' ');
    directions.push_back(parse_numbers(inside, "space directions", path));
    double square = 0;
    for (double component : directions.back()) square += component * component;
    lengths.push_back(std::sqrt(square));
    at = end;
  }
  constexpr double most_cosine = 0.01;
  for (std::size_t i = 0; i < directions.size(); ++i)
    for (std::size_t j = 0; j < i; ++j) {
      double product = 0;
      for (std::size_t k = 0; k < std::min(directions[i].size(), directions[j].size()); ++k)
        product += directions[i][k] * directions[j][k];
      if (std::abs(product) > most_cosine * lengths[i] * lengths[j])
        throw InputError(
            fmt::format("{}: its axes {} and {} are not perpendicular ('space directions'); resample it on a "
                        "rectangular grid",
                        path, j + 1, i + 1));
    }
  return lengths;
}

}  // namespace

ScalarType scalar_type(const std::string& name) {
  static const std::map<std::string, ScalarType> names = {{"int8", ScalarType::int8},
                                                          {"signed char", ScalarType::int8},
                                                          {"int8_t", ScalarType::int8},
                                                          {"uint8", ScalarType::uint8},
                                                          {"uchar", ScalarType::uint8},
                                                          {"unsigned char", ScalarType::uint8},
                                                          {"uint8_t", ScalarType::uint8},
                                                          {"int16", ScalarType::int16},
                                                          {"short", ScalarType::int16},
                                                          {"short int", ScalarType::int16},
                                                          {"signed short", ScalarType::int16},
                                                          {"int16_t", ScalarType::int16},
                                                          {"uint16", ScalarType::uint16},
                                                          {"ushort", ScalarType::uint16},
                                                          {"unsigned short", ScalarType::uint16},
                                                          {"uint16_t", ScalarType::uint16},
                                                          {"int32", ScalarType::int32},
                                                          {"int", ScalarType::int32},
                                                          {"signed int", ScalarType::int32},
                                                          {"int32_t", ScalarType::int32},
                                                          {"uint32", ScalarType::uint32},
                                                          {"uint", ScalarType::uint32},
                                                          {"unsigned int", ScalarType::uint32},
                                                          {"uint32_t", ScalarType::uint32},
                                                          {"int64", ScalarType::int64},
                                                          {"longlong", ScalarType::int64},
                                                          {"long long", ScalarType::int64},
                                                          {"int64_t", ScalarType::int64},
                                                          {"uint64", ScalarType::uint64},
                                                          {"ulonglong", ScalarType::uint64},
                                                          {"unsigned long long", ScalarType::uint64},
                                                          {"uint64_t", ScalarType::uint64},
                                                          {"float", ScalarType::float32},
                                                          {"float32", ScalarType::float32},
                                                          {"double", ScalarType::float64},
                                                          {"float64", ScalarType::float64}};
  const auto found = names.find(name);
  if (found == names.end())
    throw InputError(
        fmt::format("'{}' is no type of values; expected int8, uint8, int16, uint16, int32, uint32, int64, "
                    "uint64, float or double",
                    name.substr(0, 40)));
  return found->second;
}

ScalarVolume read_raw_volume(const std::string& path, const RawLayout& layout) {
  check_size(layout.size, path);
  const std::string bytes = read_text(path);
  if (layout.offset > bytes.size())
    throw InputError(fmt::format("{}: holds {} bytes, fewer than the offset {}", path, bytes.size(), layout.offset));
  return decode_volume(std::string_view(bytes).substr(layout.offset), layout, path);
}

ScalarVolume read_nrrd(const std::string& path) {
  const std::string whole = read_text(path);
  const NrrdHeader header = parse_header(whole, path);
  const auto field = [&](const std::string& name) -> std::optional<std::string> {
    const auto found = header.fields.find(name);
    return found == header.fields.end() ? std::nullopt : std::optional(found->second);
  };
  const auto required = [&](const std::string& name) {
    if (!field(name)) throw InputError(fmt::format("{}: the field '{}' is missing", path, name));
    return *field(name);
  };
  if (required("dimension") != "3")
    throw InputError(
        fmt::format("{}: has {} axes; expected 3 of one value each", path, required("dimension").substr(0, 20)));
  const std::vector<double> sizes = parse_numbers(required("sizes"), "sizes", path);
  if (sizes.size() != 3) throw InputError(path + ": the field 'sizes' does not hold three numbers");
  for (double size : sizes)
    if (!(size >= 1 && size <= 1e6) || size != std::floor(size))
      throw InputError(path + ": the field 'sizes' is out of range");
  RawLayout layout;
  layout.size = Vec3i(static_cast<int>(sizes[0]), static_cast<int>(sizes[1]), static_cast<int>(sizes[2]));
  check_size(layout.size, path);
  layout.type = naming(path, [&] { return scalar_type(required("type")); });
  const std::string encoding = required("encoding");
  const bool text = encoding == "ascii" || encoding == "text" || encoding == "txt";
  const bool packed = encoding == "gzip" || encoding == "gz";
  if (!text && !packed && encoding != "raw")
    throw InputError(
        fmt::format("{}: the encoding '{}' is not read; expected raw, gzip or text", path, encoding.substr(0, 40)));
  const std::string endian = field("endian").value_or("little");
  if (endian != "little" && endian != "big") throw InputError(path + ": the field 'endian' is neither little nor big");
  layout.big_endian = endian == "big";

  std::string data_path = path, detached;
  std::string_view data = std::string_view(whole).substr(header.end);
  if (const auto file = field("data file") ? field("data file") : field("datafile")) {
    if (file->find_first_of(" %") != std::string::npos || *file == "LIST")
      throw InputError(fmt::format("{}: values in several files are not read; join them into one", path));
    data_path = (std::filesystem::path(path).parent_path() / *file).string();
    detached = naming(path, [&] { return read_text(data_path); });
    data = detached;
  }
  const auto skip = [&](const char* spaced, const char* joined) {
    const std::vector<double> number = parse_numbers(field(spaced).value_or(field(joined).value_or("0")), spaced, path);
    if (number.size() != 1 || !(number[0] >= -1 && number[0] <= 1e12) || number[0] != std::floor(number[0]))
      throw InputError(fmt::format("{}: the field '{}' is out of range", path, spaced));
    return static_cast<std::int64_t>(number[0]);
  };
  for (std::int64_t lines = std::max<std::int64_t>(0, skip("line skip", "lineskip")); lines > 0 && !data.empty();
       --lines)
    data.remove_prefix(std::min(data.find('\n'), data.size() - 1) + 1);
  std::int64_t bytes_to_skip = skip("byte skip", "byteskip");
  const std::size_t needed = static_cast<std::size_t>(layout.size.cast<double>().prod()) * value_bytes(layout.type);

  ScalarVolume volume;
  if (text) {
    volume.size = layout.size;
    volume.values.reserve(std::min(volume.count(), data.size()));
    std::istringstream words{std::string(data)};
    for (std::string word; volume.values.size() < volume.count() && words >> word;) {
      if (word.back() == ',') word.pop_back();
      volume.values.push_back(static_cast<float>(parse_numbers(word, "data", path).at(0)));
    }
    if (volume.values.size() < volume.count())
      throw InputError(fmt::format("{}: holds {} values, {} are promised", path, volume.values.size(), volume.count()));
    check_finite(volume, path);
  } else {
    std::string inflated;
    if (packed) {
      // Bytes are skipped in what comes out.
      inflated = inflate_gzip(data, needed + static_cast<std::size_t>(std::max<std::int64_t>(0, bytes_to_skip)), path);
      data = inflated;
    }
    if (bytes_to_skip == -1) bytes_to_skip = data.size() > needed ? static_cast<std::int64_t>(data.size() - needed) : 0;
    if (static_cast<std::size_t>(bytes_to_skip) > data.size())
      throw InputError(path + ": the field 'byte skip' is beyond the file's end");
    data.remove_prefix(static_cast<std::size_t>(bytes_to_skip));
    volume = decode_volume(data, layout, path);
  }

  std::vector<double> spacing;
  if (field("space directions")) {
    spacing = direction_lengths(*field("space directions"), path);
  } else if (field("spacings")) {
    // "NaN" stands for an axis that has none.
    spacing = parse_numbers(*field("spacings"), "spacings", path);
  }
  if (!spacing.empty()) {
    if (spacing.size() != 3) throw InputError(path + ": the spacing does not hold three numbers");
    for (int axis = 0; axis < 3; ++axis)
      if (!(spacing[axis] > 1e-9 && spacing[axis] < 1e9))
        throw InputError(fmt::format("{}: a spacing of {:.6g} is out of range", path, spacing[axis]));
    volume.spacing = Vec3(spacing[0], spacing[1], spacing[2]);
  }
  return volume;
}

ScalarVolume read_image_stack(const std::vector<std::string>& paths) {
  ScalarVolume volume;
  for (const std::string& path : paths) {
    const Image image = read_grey_png(path);
    if (volume.values.empty()) {
      volume.size = Vec3i(image.width, image.height, static_cast<int>(paths.size()));
      check_size(volume.size, path);
      volume.values.reserve(volume.count());
    }
    if (image.width != volume.size.x() || image.height != volume.size.y())
      throw InputError(fmt::format("{}: {} by {} pixels, the first image of the stack has {} by {}", path, image.width,
                                   image.height, volume.size.x(), volume.size.y()));
    volume.values.insert(volume.values.end(), image.channels[0].values.begin(), image.channels[0].values.end());
  }
  return volume;
}

}  // namespace shellgrid
