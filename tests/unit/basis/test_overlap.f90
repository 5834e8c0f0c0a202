!> Domains that overlap (fuzzy particles): what becomes of nodal masses on a stretched line of particles
program test_overlap
  use gimp_kinds, only: wp
  use gimp_basis, only: weight_list_t, make_weight_list
  use gimp_splines, only: spline_t
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check
  implicit none(type, external)

  real(wp), parameter :: stretch = 1.1_wp
  integer, parameter :: cells = 44, per_cell = 2 !! 88 particles 0.55 h apart: 48.4 h
  real(wp) :: uneven(4)
  integer :: k
  real(wp), parameter :: factor(4) = [1.0_wp, 1.2_wp, 1.5_wp, 2.0_wp]
  !> Largest deviation of an inner nodal mass from density times h. Domains that tile the line once or twice give none; between
  !> them the kernels do not add up to a constant; a sum over thin slices of the domains in numpy gives the same figures
  real(wp), parameter :: expected(4) = [0.0_wp, 4.98e-3_wp, 3.33e-3_wp, 0.0_wp]

  call begin_suite("overlap")
  do k = 1, 4
    call inner_masses(factor(k), uneven(k))
    call check(uneven(k), expected(k), merge(1.0e-13_wp, 0.01_wp*expected(k), expected(k) == 0.0_wp), "inner masses, factor "//text_of(factor(k)))
  end do
  call end_suite()

contains

  subroutine inner_masses(overlap, deviation)
    real(wp), intent(in) :: overlap
    real(wp), intent(out) :: deviation
    type(weight_list_t) :: list
    type(spline_t) :: none
    real(wp) :: m(-5:60), x, half
    integer :: p, i
    m = 0.0_wp
    half = 0.5_wp*stretch/per_cell
    do p = 1, cells*per_cell
      x = 2.0_wp*half*(p - 0.5_wp)
      call make_weight_list(1, [x], [overlap*half], none, list)
      do i = 1, list%n
        m(list%node(1, i)) = m(list%node(1, i)) + 2.0_wp*half*list%s(i) ! density 1
      end do
    end do
    call check(sum(m), stretch*cells, 1.0e-12_wp, "sum of masses, factor "//text_of(overlap))
    deviation = maxval(abs(m(4:44) - 1.0_wp))
  end subroutine inner_masses

end program test_overlap
