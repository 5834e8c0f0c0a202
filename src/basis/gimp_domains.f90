!> Half lengths of particle domains that follow the deformation (cpGIMP), for the lanes of one chunk
module gimp_domains
  use gimp_kinds, only: wp, lanes
  use gimp_tensor, only: polar_rotation
  use gimp_basis, only: longest_half
  implicit none(type, external)
  private
  public :: domain_half_lengths, domain_of_word, domain_stretch, domain_diagonal, domain_volume, domain_edges, domain_fixed, domain_carried

  integer, parameter :: domain_stretch = 1, domain_diagonal = 2, domain_volume = 3
  integer, parameter :: domain_fixed = 0 !! domains stay as they are
  integer, parameter :: domain_edges = 4 !! half-edge vectors r_k = F r_k0 (see gimp_point_domains)
  integer, parameter :: domain_carried = 5 !! corners move with the grid (see gimp_corner_domains)
  real(wp), parameter :: shortest_half = 1.0e-3_wp !! [cells]

contains

  !> Number of a rule from its word in the scene, 0 if there is none
  pure integer function domain_of_word(word) result(rule)
    character(len=*), intent(in) :: word
    select case (word)
    case ("stretch"); rule = domain_stretch
    case ("diagonal"); rule = domain_diagonal
    case ("volume"); rule = domain_volume
    case default; rule = 0
    end select
  end function domain_of_word

  !> Half lengths from the initial ones: l = l0 U_kk (stretch; U = sqrt(F^T F), Charlton, Coombs & Augarde 2017), l = l0 F_kk
  !> (diagonal; Wallstedt & Guilkey 2008) or l = l0 J^(1/dim) (volume). Clamped to 0.001 .. 2 cells; `clamped` counts.
  pure subroutine domain_half_lengths(rule, dim, f, half0, half, clamped)
    integer, intent(in) :: rule, dim
    real(wp), intent(in) :: f(lanes, 9) !! deformation gradient
    real(wp), intent(in) :: half0(lanes, 3) !! initial half lengths [cells]
    real(wp), intent(out) :: half(lanes, 3) !! present half lengths [cells]
    integer, intent(inout) :: clamped !! domains that were shortened
    real(wp) :: u(lanes, 3)
    integer :: i, k
    select case (rule)
    case (domain_diagonal)
      do k = 1, 3
        u(:, k) = f(:, 4*k - 3)
      end do
    case (domain_volume)
      call mean_stretch(dim, f, u)
    case default
      if (dim == 3) then
        call stretch_3d(f, u)
      else
        call stretch_2d(f, u)
      end if
    end select
    do k = 1, 3
      !$omp simd simdlen(lanes)
      do i = 1, lanes
        half(i, k) = min(longest_half, max(shortest_half, half0(i, k)*u(i, k)))
      end do
    end do
    if (any(half >= longest_half)) clamped = clamped + count(half0*u > longest_half)
  end subroutine domain_half_lengths

  pure subroutine mean_stretch(dim, f, u)
    integer, intent(in) :: dim
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(out) :: u(lanes, 3)
    real(wp) :: j
    integer :: i
    do i = 1, lanes
      j = f(i, 1)*(f(i, 5)*f(i, 9) - f(i, 6)*f(i, 8)) - f(i, 2)*(f(i, 4)*f(i, 9) - f(i, 6)*f(i, 7)) &
        + f(i, 3)*(f(i, 4)*f(i, 8) - f(i, 5)*f(i, 7))
      u(i, :) = max(j, 0.0_wp)**(1.0_wp/dim)
    end do
  end subroutine mean_stretch

  !> Diagonal of U in the plane: U = (C + J I)/sqrt(tr C + 2 J), exact (Hoger & Carlson 1984); J of the plane part.
  !> In 1D the second axis has F = 1 and the same formula holds.
  pure subroutine stretch_2d(f, u)
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(out) :: u(lanes, 3)
    real(wp) :: j, c11, c22, r
    integer :: i
    !$omp simd simdlen(lanes) private(j, c11, c22, r)
    do i = 1, lanes
      j = abs(f(i, 1)*f(i, 5) - f(i, 2)*f(i, 4))
      c11 = f(i, 1)*f(i, 1) + f(i, 4)*f(i, 4)
      c22 = f(i, 2)*f(i, 2) + f(i, 5)*f(i, 5)
      r = 1.0_wp/sqrt(max(c11 + c22 + 2.0_wp*j, tiny(1.0_wp)))
      u(i, 1) = (c11 + j)*r
      u(i, 2) = (c22 + j)*r
      u(i, 3) = 1.0_wp
    end do
  end subroutine stretch_2d

  !> Diagonal of U in space: U_kk = sum_i R_ik F_ik with the rotation R of F
  pure subroutine stretch_3d(f, u)
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(out) :: u(lanes, 3)
    real(wp) :: r(lanes, 9)
    integer :: i
    call polar_rotation(f, r)
    !$omp simd simdlen(lanes)
    do i = 1, lanes
      u(i, 1) = r(i, 1)*f(i, 1) + r(i, 4)*f(i, 4) + r(i, 7)*f(i, 7)
      u(i, 2) = r(i, 2)*f(i, 2) + r(i, 5)*f(i, 5) + r(i, 8)*f(i, 8)
      u(i, 3) = r(i, 3)*f(i, 3) + r(i, 6)*f(i, 6) + r(i, 9)*f(i, 9)
    end do
  end subroutine stretch_3d

end module gimp_domains
