"""A bluetoothd for tests: a template of python3-dbusmock that tells beacons as BlueZ 5.66 does.

  python3 -m dbusmock --session --template bluez_5_66.py

What it keeps of BlueZ (src/adapter.c, src/device.c, doc/device-api.txt):
- a device appears with InterfacesAdded when its first packet arrives, its RSSI and data among the properties;
- further packets change RSSI when it differs, by any amount with DuplicateData, by 8 dB or more without;
- ManufacturerData (a{qv}) and ServiceData (a{sv}) are told again when they differ, and with DuplicateData always;
- all changes of one packet are one PropertiesChanged;
- nothing is told without discovery; when it ends, and when the radio goes off, each RSSI is withdrawn as invalidated;
- StartDiscovery on a radio that is off is org.bluez.Error.NotReady, twice is org.bluez.Error.InProgress;
- a radio that is unplugged goes with InterfacesRemoved, its devices before it; no property says that discovery has ended.
org.bluez.Mock at / is what the tests drive.
"""
import dbus
from dbusmock import OBJECT_MANAGER_IFACE, mockobject

BUS_NAME = "org.bluez"
MAIN_OBJ = "/"
MAIN_IFACE = "org.bluez.Mock"
SYSTEM_BUS = False
IS_OBJECT_MANAGER = True

ADAPTER, DEVICE = "org.bluez.Adapter1", "org.bluez.Device1"
PROPERTIES = "org.freedesktop.DBus.Properties"
RSSI_DELTA = 8


def load(mock, parameters):
    mock.refuses = False


def path_of(adapter, address):
    return "/org/bluez/%s/dev_%s" % (adapter, address.upper().replace(":", "_"))


def told(path, interface, changed, invalidated=()):
    obj = mockobject.objects[path]
    obj.props[interface].update(changed)
    for name in invalidated:
        obj.props[interface].pop(name, None)
    obj.EmitSignal(PROPERTIES, "PropertiesChanged", "sa{sv}as",
                   [interface, dbus.Dictionary(changed, signature="sv"), dbus.Array(invalidated, signature="s")])


def manufacturer_data(data):
    return dbus.Dictionary({dbus.UInt16(k): dbus.Array(v, signature="y", variant_level=1) for k, v in data.items()},
                           signature="qv", variant_level=0)


def service_data(data):
    return dbus.Dictionary({dbus.String(k): dbus.Array(v, signature="y", variant_level=1) for k, v in data.items()},
                           signature="sv")


@dbus.service.method(MAIN_IFACE, in_signature="ssb")
def AddAdapter(self, name, address, powered):
    path = "/org/bluez/" + name
    self.AddObject(path, ADAPTER, {"Address": dbus.String(address), "Name": dbus.String(name),
                                   "Powered": dbus.Boolean(powered), "Discovering": dbus.Boolean(False)},
                   [("SetDiscoveryFilter", "a{sv}", "", "self.duplicates = bool(args[0].get('DuplicateData', False))"),
                    ("StartDiscovery", "", "", "objects['/'].start_discovery(self)"),
                    ("StopDiscovery", "", "", "objects['/'].stop_discovery(self)")])
    mockobject.objects[path].duplicates = False
    self.start_discovery, self.stop_discovery = start_discovery, stop_discovery
    self.EmitSignal(OBJECT_MANAGER_IFACE, "InterfacesAdded", "oa{sa{sv}}",
                    [dbus.ObjectPath(path), {ADAPTER: mockobject.objects[path].props[ADAPTER]}])


@dbus.service.method(MAIN_IFACE, in_signature="s")
def RemoveAdapter(self, name):
    path = "/org/bluez/" + name
    for device in [one for one in mockobject.objects if one.startswith(path + "/dev_")]:
        remove(self, device, DEVICE)
    remove(self, path, ADAPTER)


def remove(manager, path, interface):
    manager.RemoveObject(path)
    manager.EmitSignal(OBJECT_MANAGER_IFACE, "InterfacesRemoved", "oas",
                       [dbus.ObjectPath(path), [PROPERTIES, interface]])


@dbus.service.method(MAIN_IFACE, in_signature="b")
def Refuse(self, refuses):
    """As a policy of the bus does, of whose changes nobody is told."""
    self.refuses = refuses


def start_discovery(adapter):
    if mockobject.objects["/"].refuses:
        raise dbus.exceptions.DBusException("Not permitted", name="org.freedesktop.DBus.Error.AccessDenied")
    if not adapter.props[ADAPTER]["Powered"]:
        raise dbus.exceptions.DBusException("Resource Not Ready", name="org.bluez.Error.NotReady")
    if adapter.props[ADAPTER]["Discovering"]:
        raise dbus.exceptions.DBusException("Operation already in progress", name="org.bluez.Error.InProgress")
    told(adapter.path, ADAPTER, {"Discovering": dbus.Boolean(True)})


def stop_discovery(adapter):
    for path, obj in mockobject.objects.items():
        if path.startswith(adapter.path + "/dev_") and "RSSI" in obj.props[DEVICE]:
            told(path, DEVICE, {}, ["RSSI"])
    told(adapter.path, ADAPTER, {"Discovering": dbus.Boolean(False)})


@dbus.service.method(MAIN_IFACE, in_signature="sb")
def Power(self, name, on):
    adapter = mockobject.objects["/org/bluez/" + name]
    if not on:
        stop_discovery(adapter)
    told(adapter.path, ADAPTER, {"Powered": dbus.Boolean(on)})


@dbus.service.method(MAIN_IFACE, in_signature="s")
def EndDiscovery(self, name):
    stop_discovery(mockobject.objects["/org/bluez/" + name])


@dbus.service.method(MAIN_IFACE, in_signature="s", out_signature="bb")
def Discovers(self, name):
    adapter = mockobject.objects["/org/bluez/" + name]
    return bool(adapter.props[ADAPTER]["Discovering"]), adapter.duplicates


@dbus.service.method(MAIN_IFACE, in_signature="ss")
def Forget(self, name, address):
    remove(self, path_of(name, address), DEVICE)


@dbus.service.method(MAIN_IFACE, in_signature="ssna{qay}a{say}")
def Packet(self, name, address, rssi, manufacturer, service):
    adapter = mockobject.objects["/org/bluez/" + name]
    if not adapter.props[ADAPTER]["Discovering"]:
        return
    data = {}
    if manufacturer:
        data["ManufacturerData"] = manufacturer_data(manufacturer)
    if service:
        data["ServiceData"] = service_data(service)
    path = path_of(name, address)
    if path not in mockobject.objects:
        self.AddObject(path, DEVICE, {"Address": dbus.String(address), "AddressType": dbus.String("random"),
                                      "Adapter": dbus.ObjectPath(adapter.path), "RSSI": dbus.Int16(rssi), **data}, [])
        self.EmitSignal(OBJECT_MANAGER_IFACE, "InterfacesAdded", "oa{sa{sv}}",
                        [dbus.ObjectPath(path), {DEVICE: mockobject.objects[path].props[DEVICE]}])
        return
    known = mockobject.objects[path].props[DEVICE]
    changed = {k: v for k, v in data.items() if adapter.duplicates or known.get(k) != v}
    before = known.get("RSSI")
    if before is None or abs(before - rssi) >= (1 if adapter.duplicates else RSSI_DELTA):
        changed["RSSI"] = dbus.Int16(rssi)
    if changed:
        told(path, DEVICE, changed)


@dbus.service.method(MAIN_IFACE, in_signature="ss")
def Nonsense(self, name, address):
    """What no bluetoothd says: properties of other types."""
    path = path_of(name, address)
    mockobject.objects[path].EmitSignal(PROPERTIES, "PropertiesChanged", "sa{sv}as",
                                        [DEVICE, dbus.Dictionary({"RSSI": dbus.String("loud")}, signature="sv"), dbus.Array([], signature="s")])
    mockobject.objects[path].EmitSignal(PROPERTIES, "PropertiesChanged", "sa{sv}as",
                                        [DEVICE, dbus.Dictionary({"ManufacturerData": dbus.Array([1, 2], signature="i")}, signature="sv"),
                                         dbus.Array([], signature="s")])
