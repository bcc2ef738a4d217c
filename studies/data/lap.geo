// Two plates, lap-jointed (mm), drawn with: gmsh -2 -format msh41 lap.geo
// Other sizes: gmsh -2 -setnumber thick 2 -setnumber fine 0.1 -o mine.msh lap.geo
DefineConstant[
  length = 30, // of each plate outside the overlap
  overlap = 25,
  thick = 5, // of each plate
  fine = 0.25, // cells on the glue
  coarse = 2.5 // cells far from it
];

Point(1) = {-length, -thick, 0, coarse};
Point(2) = {overlap, -thick, 0, coarse / 2};
Point(3) = {overlap, 0, 0, fine};
Point(4) = {0, 0, 0, fine};
Point(5) = {-length, 0, 0, coarse};
Point(6) = {overlap + length, 0, 0, coarse};
Point(7) = {overlap + length, thick, 0, coarse};
Point(8) = {0, thick, 0, coarse / 2};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 1};
Line(6) = {3, 6}; Line(7) = {6, 7}; Line(8) = {7, 8}; Line(9) = {8, 4};
Curve Loop(1) = {1, 2, 3, 4, 5}; Plane Surface(1) = {1};
Curve Loop(2) = {-3, 6, 7, 8, 9}; Plane Surface(2) = {2};

Physical Surface("LOWER PLATE") = {1};
Physical Surface("UPPER PLATE") = {2};
Physical Curve("GLUE") = {3};
Physical Curve("LEFT") = {5};
Physical Curve("RIGHT") = {7};
