"""Words of other languages in names of columns, with their meaning in English."""

from __future__ import annotations

import re
import unicodedata

WORDS = {
    "time": "zeit temps tiempo tempo",
    "timestamp": "zeitstempel horodatage",
    "angle": "winkel drehwinkel angolo angulo",
    "position": "weg deplacement posizione posicion posicao spostamento desplazamiento",
    "height": "hohe hoehe hauteur altezza altura",
    "joint": "gelenk articulation giunto articulacion articulacao",
    "shoulder": "schulter epaule spalla hombro ombro",
    "elbow": "ellbogen coude gomito codo cotovelo",
    "pole": "pendel pendule pendolo pendulo",
    "cart": "wagen chariot carrello carro",
    "carriage": "schlitten",
    "motor": "moteur motore",
    "velocity": "geschwindigkeit vitesse velocita velocidad velocidade",
    "speed": "drehzahl",
    "acceleration": "beschleunigung accelerazione aceleracion aceleracao",
    "torque": "drehmoment couple coppia binario",
    "force": "kraft forza fuerza forca",
    "current": "strom courant corrente corriente",
    "voltage": "spannung tension tensione tensao voltaje",
    "input": "eingang stellgrosse stellgroesse entree ingresso entrada",
    "command": "commande comando",
    "setpoint": "soll sollwert consigne consigna",
    "temperature": "temperatur temperatura",
}
"""Words without accents, by an English one of the same kind; what is the same there is not named.
"""
ENGLISH = {word: english for english, words in WORDS.items() for word in words.split()}
HEADS = (
    "winkel|weg|position|geschwindigkeit|drehzahl|beschleunigung|moment|kraft|strom|spannung|wert"
)
"""Last parts of German compounds, which say the kind of a column."""
COMPOUND = re.compile(rf"(soll|ist)?(.*?)((?:{HEADS})\d*)?", re.I)
RPM = re.compile(r"\b(?:U|1|tr|rev)/min\b", re.I)


def plain(name: str) -> str:
    """Return a name in ASCII letters where it has accents, revolutions a minute as ``rpm``."""
    letters = unicodedata.normalize("NFKD", RPM.sub("rpm", name).replace("ß", "ss"))
    return "".join(x for x in letters if not unicodedata.combining(x))


def parts_of(word: str) -> list[str]:
    """Return the parts of a German compound, ``Soll`` and ``winkel``; of another word, itself."""
    if english(word) != word:
        return [word]
    match = COMPOUND.fullmatch(word)
    return list(filter(None, match.groups())) if match else [word]


def english(word: str) -> str:
    """Return an English word of the same kind, with the same number at its end."""
    stem = word.rstrip("0123456789")
    known = ENGLISH.get(stem.lower())
    return word if known is None else known + word[len(stem) :]
