// Masonry arch of five stones (m), drawn with: gmsh -2 -order 2 -format msh41 arch.geo
inner = 1.0; outer = 1.3; // radii of intrados and extrados
stones = 5;
from = Pi / 6; to = 5 * Pi / 6; // springings
fine = 0.015; coarse = 0.06;

Point(1) = {0, 0, 0};
For k In {0:stones}
  angle = from + (to - from) * k / stones;
  Point(10 + k) = {inner * Cos(angle), inner * Sin(angle), 0};
  Point(30 + k) = {outer * Cos(angle), outer * Sin(angle), 0};
  Line(100 + k) = {10 + k, 30 + k};
EndFor
For k In {0:stones - 1}
  Circle(200 + k) = {10 + k, 1, 11 + k};
  Circle(300 + k) = {30 + k, 1, 31 + k};
  Curve Loop(k + 1) = {100 + k, 300 + k, -(101 + k), -(200 + k)};
  Plane Surface(k + 1) = {k + 1};
EndFor

Physical Surface("EVEN STONES") = {2, 4};
Physical Surface("ODD STONES") = {1, 3, 5};
Physical Curve("JOINTS") = {101, 102, 103, 104};
Physical Curve("INTRADOS") = {200:204};
Physical Curve("EXTRADOS") = {300:304};
Physical Curve("SPRINGINGS") = {100, 105};

Field[1] = Distance;
Field[1].CurvesList = {101, 102, 103, 104};
Field[1].Sampling = 200;
Field[2] = Threshold;
Field[2].InField = 1;
Field[2].SizeMin = fine;
Field[2].SizeMax = coarse;
Field[2].DistMin = 0.01;
Field[2].DistMax = 0.15;
Background Field = 2;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
