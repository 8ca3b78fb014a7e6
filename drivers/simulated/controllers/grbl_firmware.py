"""Two firmwares as a simulated GRBL can be: GRBL 1.1h and grblHAL, word for word as recorded from the real ones."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Firmware:
    """Differences between the firmwares. defaults: settings as printed, by number."""

    banner: str
    about: tuple[str, ...]
    defaults: dict[int, str]
    blocks: int
    room: int
    homed_axes: int
    is_hal: bool = False

    def show(self, number: int, value: float) -> str:
        """Return a setting's value with the firmware's number of decimals."""
        return f"{value:.{len(self.defaults[number].partition('.')[2])}f}"


def _settings(text: str) -> dict[int, str]:
    pairs = (item.split("=") for item in text.split())
    return {int(number): value for number, value in pairs}


GRBL = Firmware(
    banner="Grbl 1.1h ['$' for help]",
    about=("[VER:1.1h.20190830:]", "[OPT:{options},15,128]"),
    defaults=_settings(
        "0=10 1=25 2=0 3=0 4=0 5=0 6=0 10=1 11=0.010 12=0.002 13=0 20=0 21=0 22=0 23=0 24=25.000 25=500.000 26=250"
        " 27=1.000 30=1000 31=0 32=0 100=250.000 101=250.000 102=250.000 110=500.000 111=500.000 112=500.000"
        " 120=10.000 121=10.000 122=10.000 130=200.000 131=200.000 132=200.000"
    ),
    blocks=15,
    room=128,
    homed_axes=3,
)

GRBL_HAL = Firmware(
    banner="GrblHAL 1.1f ['$' or '$HELP' for help]",
    about=(
        "[VER:1.1f.20260817:]",
        "[OPT:{options},100,1024,3,0]",
        "[AXS:3:XYZ]",
        "[NEWOPT:ENUMS,RT+,TC,SED]",
        "[FIRMWARE:grblHAL]",
        "[SIGNALS:D]",
        "[NVS STORAGE:*EEPROM]",
        "[DRIVER:Simulator]",
        "[DRIVER VERSION:260324]",
    ),
    defaults=_settings(
        "0=5.0 1=25 2=0 3=0 4=7 5=0 6=0 9=1 10=511 11=0.010 12=0.002 13=0 14=0 15=0 17=0 18=0 19=0 20=0 21=0 22=0"
        " 23=0 24=25.0 25=500.0 26=250 27=1.000 28=0.100 29=0.0 30=1000.000 31=0.000 32=0 33=5000.0 34=0.0 35=0.0"
        " 36=100.0 37=0 39=1 40=0 41=0 42=2 43=1 44=4 45=3 46=0 56=5.0 57=100.0 58=-5.0 59=500.0 60=0 61=0 62=0"
        " 63=3 64=0 65=0 100=250.00000 101=250.00000 102=250.00000 110=500.000 111=500.000 112=500.000 120=10.000"
        " 121=10.000 122=10.000 130=200.000 131=200.000 132=200.000 341=0 342=30.0 343=25.0 344=200.0 345=200.0"
        " 346=1 384=0 392=4.0 393=1.0 394=0.0 398=100 481=0 485=0 486=0 539=0.0 673=0.0 676=15 680=0"
    ),
    blocks=100,
    room=1023,
    homed_axes=1,
    is_hal=True,
)
