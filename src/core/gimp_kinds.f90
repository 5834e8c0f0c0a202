!> Kinds, the width of a chunk and the one ordering convention of the project.
!>
!> Conventions (everywhere, storage and output): tension positive; symmetric tensors as six numbers in the order
!> xx, yy, zz, xy, yz, zx with tensor shear (not doubled); full tensors row by row, component 3*(i-1)+j is A_ij;
!> L_ij = dv_i/dx_j; half lengths are half the edge of a particle's domain; SI units.
module gimp_kinds
  use, intrinsic :: iso_fortran_env, only: real64, int64
  implicit none(type, external)
  private
  public :: wp, dp, i8, lanes, pi

  integer, parameter :: wp = real64 !! working precision of particles and grid
  integer, parameter :: dp = real64 !! double precision whatever wp is: books, output of scalars
  integer, parameter :: i8 = int64 !! global counts, keys, ids, byte sizes
  integer, parameter :: lanes = 8 !! particles in one chunk: one 64-byte vector in double precision
  real(wp), parameter :: pi = acos(-1.0_wp)
end module gimp_kinds
