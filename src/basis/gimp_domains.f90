!> Half lengths of particle domains that follow the deformation (cpGIMP), for the lanes of one chunk
module gimp_domains
  use gimp_kinds, only: wp, lanes
  use gimp_basis, only: longest_half
  implicit none(type, external)
  private
  public :: domain_half_lengths, domain_of_word, domain_stretch, domain_diagonal, domain_volume, domain_edges

  integer, parameter :: domain_stretch = 1, domain_diagonal = 2, domain_volume = 3
  integer, parameter :: domain_edges = 4 !! half-edge vectors r_k = F r_k0 (see gimp_point_domains)
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

  !> Diagonal of U in space: R by Newton's iteration for the polar decomposition, R <- (R + R^-T)/2 from F scaled to unit
  !> size (Higham 1986), then U_kk = sum_i R_ik F_ik. Ten steps reach round-off for principal stretch ratios up to about 60 (see
  !> the unit test); usual strains take three or four. A lane whose last step was below `settled` stands still, since the next one
  !> would be its square: so a lane never depends on how long its neighbours take.
  pure subroutine stretch_3d(f, u)
    real(wp), intent(in) :: f(lanes, 9)
    real(wp), intent(out) :: u(lanes, 3)
    integer, parameter :: steps = 10
    real(wp), parameter :: settled = 0.1_wp*sqrt(epsilon(1.0_wp))
    real(wp) :: r(lanes, 9), moving(lanes), scale, d, h, change, a1, a2, a3, a4, a5, a6, a7, a8, a9
    integer :: i, k
    !$omp simd simdlen(lanes) private(scale)
    do i = 1, lanes
      scale = 1.0_wp/sqrt(max((f(i, 1)**2 + f(i, 2)**2 + f(i, 3)**2 + f(i, 4)**2 + f(i, 5)**2 + f(i, 6)**2 &
                               + f(i, 7)**2 + f(i, 8)**2 + f(i, 9)**2)/3.0_wp, tiny(1.0_wp)))
      r(i, 1) = f(i, 1)*scale; r(i, 2) = f(i, 2)*scale; r(i, 3) = f(i, 3)*scale
      r(i, 4) = f(i, 4)*scale; r(i, 5) = f(i, 5)*scale; r(i, 6) = f(i, 6)*scale
      r(i, 7) = f(i, 7)*scale; r(i, 8) = f(i, 8)*scale; r(i, 9) = f(i, 9)*scale
    end do
    moving = 1.0_wp
    do k = 1, steps
      !$omp simd simdlen(lanes) private(d, h, change, a1, a2, a3, a4, a5, a6, a7, a8, a9)
      do i = 1, lanes
        a1 = r(i, 5)*r(i, 9) - r(i, 6)*r(i, 8) ! cofactors: R^-T = cof R / det R
        a2 = r(i, 6)*r(i, 7) - r(i, 4)*r(i, 9)
        a3 = r(i, 4)*r(i, 8) - r(i, 5)*r(i, 7)
        a4 = r(i, 3)*r(i, 8) - r(i, 2)*r(i, 9)
        a5 = r(i, 1)*r(i, 9) - r(i, 3)*r(i, 7)
        a6 = r(i, 2)*r(i, 7) - r(i, 1)*r(i, 8)
        a7 = r(i, 2)*r(i, 6) - r(i, 3)*r(i, 5)
        a8 = r(i, 3)*r(i, 4) - r(i, 1)*r(i, 6)
        a9 = r(i, 1)*r(i, 5) - r(i, 2)*r(i, 4)
        d = moving(i)*0.5_wp/max(r(i, 1)*a1 + r(i, 2)*a2 + r(i, 3)*a3, tiny(1.0_wp)**0.5_wp)
        h = moving(i)*0.5_wp ! R <- R + (R^-T - R)/2, or nothing
        a1 = d*a1 - h*r(i, 1); a2 = d*a2 - h*r(i, 2); a3 = d*a3 - h*r(i, 3)
        a4 = d*a4 - h*r(i, 4); a5 = d*a5 - h*r(i, 5); a6 = d*a6 - h*r(i, 6)
        a7 = d*a7 - h*r(i, 7); a8 = d*a8 - h*r(i, 8); a9 = d*a9 - h*r(i, 9)
        r(i, 1) = r(i, 1) + a1; r(i, 2) = r(i, 2) + a2; r(i, 3) = r(i, 3) + a3
        r(i, 4) = r(i, 4) + a4; r(i, 5) = r(i, 5) + a5; r(i, 6) = r(i, 6) + a6
        r(i, 7) = r(i, 7) + a7; r(i, 8) = r(i, 8) + a8; r(i, 9) = r(i, 9) + a9
        change = a1*a1 + a2*a2 + a3*a3 + a4*a4 + a5*a5 + a6*a6 + a7*a7 + a8*a8 + a9*a9
        moving(i) = merge(1.0_wp, 0.0_wp, change > settled**2)
      end do
      if (all(moving < 0.5_wp)) exit
    end do
    !$omp simd simdlen(lanes)
    do i = 1, lanes
      u(i, 1) = r(i, 1)*f(i, 1) + r(i, 4)*f(i, 4) + r(i, 7)*f(i, 7)
      u(i, 2) = r(i, 2)*f(i, 2) + r(i, 5)*f(i, 5) + r(i, 8)*f(i, 8)
      u(i, 3) = r(i, 3)*f(i, 3) + r(i, 6)*f(i, 6) + r(i, 9)*f(i, 9)
    end do
  end subroutine stretch_3d

end module gimp_domains
