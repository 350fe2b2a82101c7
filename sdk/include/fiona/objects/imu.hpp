#pragma once

#include <array>
#include <optional>

#include "fiona/sensors.pb.h"

/// Access to `fiona.sensors.GetIMU` as vectors, in the axes that phones use.
namespace fiona::sensors {

/// One reading of an inertial unit in the axes of an Android phone: x to the right of the screen, y to its
/// top edge, z out of it. GetIMU has the axes of the platform's devices: x where the device points, y to its
/// left, z up out of it. A phone that is held to be read points where its top edge points, so
///
///     x_device = y_phone,  y_device = -x_phone,  z_device = z_phone
///
/// for forces, rates of turn and fields alike: a quarter turn about z, which leaves right-handed axes
/// right-handed. The units are those of GetIMU. A sensor that the device does not have, or of which a
/// component is missing, is absent.
///
/// Source: Android developer documentation, "Sensors overview", sensor coordinate system;
/// proto/fiona/sensors.proto.
struct PhoneAxes {
  using Vector = std::array<double, 3>;  ///< x, y, z

  std::optional<Vector> acceleration_g{};  ///< specific force, gravity included: (0, 0, 1) lying flat at rest
  std::optional<Vector> rotation_deg_s{};  ///< right-handed: positive z is a turn to the left
  std::optional<Vector> magnetic_gauss{};

  bool operator==(const PhoneAxes&) const = default;
};

/// A vector of device axes in phone axes.
constexpr PhoneAxes::Vector device_to_phone(const PhoneAxes::Vector& device) {
  return {-device[1], device[0], device[2]};
}

/// A vector of phone axes in device axes.
constexpr PhoneAxes::Vector phone_to_device(const PhoneAxes::Vector& phone) { return {phone[1], -phone[0], phone[2]}; }

/// What `imu` says, in phone axes.
inline PhoneAxes to_phone_axes(const GetIMU& imu) {
  PhoneAxes phone;
  if (imu.has_out_x_ac() && imu.has_out_y_ac() && imu.has_out_z_ac()) {
    phone.acceleration_g = device_to_phone({imu.out_x_ac(), imu.out_y_ac(), imu.out_z_ac()});
  }
  if (imu.has_roll_g() && imu.has_pitch_g() && imu.has_yaw_g()) {
    phone.rotation_deg_s = device_to_phone({imu.roll_g(), imu.pitch_g(), imu.yaw_g()});
  }
  if (imu.has_out_x_m() && imu.has_out_y_m() && imu.has_out_z_m()) {
    phone.magnetic_gauss = device_to_phone({imu.out_x_m(), imu.out_y_m(), imu.out_z_m()});
  }
  return phone;
}

/// Writes a phone's reading into `imu`; what the phone does not have is cleared there.
inline void set_from_phone_axes(const PhoneAxes& phone, GetIMU& imu) {
  imu.Clear();
  if (phone.acceleration_g) {
    const auto [x, y, z] = phone_to_device(*phone.acceleration_g);
    imu.set_out_x_ac(x);
    imu.set_out_y_ac(y);
    imu.set_out_z_ac(z);
  }
  if (phone.rotation_deg_s) {
    const auto [x, y, z] = phone_to_device(*phone.rotation_deg_s);
    imu.set_roll_g(x);
    imu.set_pitch_g(y);
    imu.set_yaw_g(z);
  }
  if (phone.magnetic_gauss) {
    const auto [x, y, z] = phone_to_device(*phone.magnetic_gauss);
    imu.set_out_x_m(x);
    imu.set_out_y_m(y);
    imu.set_out_z_m(z);
  }
}

/// A phone's reading as the message.
inline GetIMU from_phone_axes(const PhoneAxes& phone) {
  GetIMU imu;
  set_from_phone_axes(phone, imu);
  return imu;
}

}  // namespace fiona::sensors
