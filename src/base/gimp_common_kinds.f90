!> Kinds that do not depend on the working precision, for the rooms that the double and the single build share.
module gimp_common_kinds
  use, intrinsic :: iso_fortran_env, only: real32, real64, int64
  implicit none(type, external)
  private
  public :: sp, dp, i8, pi

  integer, parameter :: sp = real32 !! single precision
  integer, parameter :: dp = real64 !! double precision: books, times, places in metres, all that a scene says, output of scalars
  integer, parameter :: i8 = int64 !! global counts, keys, ids, byte sizes
  real(dp), parameter :: pi = acos(-1.0_dp)
end module gimp_common_kinds
