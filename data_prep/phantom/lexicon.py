"""The words the phantom can say: pronunciations in ARPAbet, with 1 on the stressed vowel."""

_WORDS = """
a AH0
about AH0 B AW1 T
across AH0 K R AO1 S
again AH0 G EH1 N
all AO1 L
always AO1 L W EY0 Z
and AE0 N D
answer AE1 N S ER0
apart AH0 P AA1 R T
are AA0 R
around ER0 AW1 N D
at AE0 T
balance B AE1 L AH0 N S
be B IY0
because B IH0 K AO1 Z
began B IH0 G AE1 N
better B EH1 T ER0
between B IH0 T W IY1 N
big B IH1 G
both B OW1 TH
bring B R IH1 NG
build B IH1 L D
but B AH0 T
can K AE0 N
careful K EH1 R F AH0 L
change CH EY1 N JH
city S IH1 T IY0
clear K L IH1 R
climbing K L AY1 M IH0 NG
come K AH1 M
cost K AO1 S T
data D EY1 T AH0
day D EY1
deep D IY1 P
different D IH1 F R AH0 N T
do D UW1
doctor D AA1 K T ER0
door D AO1 R
down D AW1 N
each IY1 CH
easy IY1 Z IY0
energy EH1 N ER0 JH IY0
enough IH0 N AH1 F
every EH1 V R IY0
everything EH1 V R IY0 TH IH0 NG
example IH0 G Z AE1 M P AH0 L
falling F AO1 L IH0 NG
family F AE1 M AH0 L IY0
feel F IY1 L
few F Y UW1
field F IY1 L D
find F AY1 N D
first F ER1 S T
for F ER0
from F R AH0 M
future F Y UW1 CH ER0
garden G AA1 R D AH0 N
give G IH1 V
go G OW1
good G UH1 D
great G R EY1 T
group G R UW1 P
grow G R OW1
hand HH AE1 N D
happen HH AE1 P AH0 N
hard HH AA1 R D
have HH AE0 V
heart HH AA1 R T
hear HH IH1 R
here HH IH1 R
history HH IH1 S T ER0 IY0
hope HH OW1 P
house HH AW1 S
how HH AW1
huge HH Y UW1 JH
human HH Y UW1 M AH0 N
idea AY0 D IY1 AH0
if IH0 F
important IH0 M P AO1 R T AH0 N T
in IH0 N
into IH0 N T UW0
is IH0 Z
it IH0 T
just JH AH1 S T
know N OW1
language L AE1 NG G W AH0 JH
learn L ER1 N
letter L EH1 T ER0
life L AY1 F
light L AY1 T
listen L IH1 S AH0 N
little L IH1 T AH0 L
long L AO1 NG
look L UH1 K
machine M AH0 SH IY1 N
made M EY1 D
make M EY1 K
many M EH1 N IY0
market M AA1 R K AH0 T
matter M AE1 T ER0
maybe M EY1 B IY0
me M IY1
mean M IY1 N
minute M IH1 N AH0 T
moment M OW1 M AH0 N T
money M AH1 N IY0
morning M AO1 R N IH0 NG
mountain M AW1 N T AH0 N
moving M UW1 V IH0 NG
music M Y UW1 Z IH0 K
my M AY0
nature N EY1 CH ER0
never N EH1 V ER0
new N UW1
next N EH1 K S T
no N OW1
not N AA1 T
nothing N AH1 TH IH0 NG
now N AW1
number N AH1 M B ER0
of AH0 V
offer AO1 F ER0
often AO1 F AH0 N
on AA0 N
one W AH1 N
open OW1 P AH0 N
or AO0 R
other AH1 DH ER0
our AW0 ER0
over OW1 V ER0
paper P EY1 P ER0
part P AA1 R T
people P IY1 P AH0 L
picture P IH1 K CH ER0
plan P L AE1 N
point P OY1 N T
power P AW1 ER0
prices P R AY1 S AH0 Z
problem P R AA1 B L AH0 M
question K W EH1 S CH AH0 N
reason R IY1 Z AH0 N
remember R IH0 M EH1 M B ER0
rise R AY1 Z
rising R AY1 Z IH0 NG
river R IH1 V ER0
road R OW1 D
round R AW1 N D
running R AH1 N IH0 NG
say S EY1
school S K UW1 L
science S AY1 AH0 N S
second S EH1 K AH0 N D
see S IY1
seven S EH1 V AH0 N
should SH UH0 D
show SH OW1
side S AY1 D
simple S IH1 M P AH0 L
slowly S L OW1 L IY0
small S M AO1 L
so S OW0
some S AH0 M
something S AH1 M TH IH0 NG
speak S P IY1 K
start S T AA1 R T
still S T IH1 L
stop S T AA1 P
story S T AO1 R IY0
strong S T R AO1 NG
student S T UW1 D AH0 N T
system S IH1 S T AH0 M
table T EY1 B AH0 L
take T EY1 K
teacher T IY1 CH ER0
tell T EH1 L
that DH AE0 T
the DH AH0
them DH EH0 M
there DH EH1 R
they DH EY0
thing TH IH1 NG
think TH IH1 NG K
third TH ER1 D
this DH IH0 S
three TH R IY1
time T AY1 M
tiny T AY1 N IY0
to T AH0
today T AH0 D EY1
together T AH0 G EH1 DH ER0
tomorrow T AH0 M AA1 R OW0
travel T R AE1 V AH0 L
tree T R IY1
turn T ER1 N
two T UW1
under AH1 N D ER0
up AH1 P
very V EH1 R IY0
wait W EY1 T
walking W AO1 K IH0 NG
want W AA1 N T
was W AH0 Z
water W AO1 T ER0
we W IY0
weather W EH1 DH ER0
what W AH1 T
when W EH0 N
whole HH OW1 L
why W AY1
wide W AY1 D
will W IH0 L
window W IH1 N D OW0
with W IH0 DH
wonder W AH1 N D ER0
word W ER1 D
work W ER1 K
world W ER1 L D
year Y IH1 R
yesterday Y EH1 S T ER0 D EY0
you Y UW1
young Y AH1 NG
your Y ER0
"""

LEXICON: dict[str, tuple[str, ...]] = {
    line.split()[0]: tuple(line.split()[1:]) for line in _WORDS.strip().splitlines()
}
"""Phones of each word; vowels end in 1 (stressed) or 0."""


def stressed(word: str) -> bool:
    """Whether a word of the lexicon carries stress."""
    return any(phone.endswith("1") for phone in LEXICON[word])
