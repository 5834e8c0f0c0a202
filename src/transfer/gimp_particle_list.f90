!> The weight list of one particle as the passes see it, whatever the basis: for what walks particles one by one
module gimp_particle_list
  use gimp_kinds, only: wp, lanes
  use gimp_splines, only: spline_t, make_spline
  use gimp_basis, only: weight_list_t, make_weight_list, basis_linear, basis_cpgimp, basis_ddmp, is_sampled, spline_degree
  use gimp_point_domains, only: place_points_1d, place_points_2d, place_points_3d, make_point_list
  use gimp_dual_domain, only: dual_ends, make_dual_list
  use gimp_corner_domains, only: carried_none, place_corners_1d, place_corners_2d, place_corners_3d
  use gimp_engine, only: engine_t
  implicit none(type, external)
  private
  public :: particle_list

contains

  !> Weights of lane l of chunk c, which lies in the block at `at`; nodes relative to the block, gradients per cell
  pure subroutine particle_list(engine, at, c, l, list)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: at(3), c, l
    type(weight_list_t), intent(inout) :: list
    type(spline_t) :: spline
    real(wp) :: half(3), low(3), high(3)
    integer :: q
    associate (p => engine%particles, d => engine%grid%dim)
      if (is_sampled(engine%basis)) then
        call sampled_list(engine, c, l, list)
        return
      end if
      if (engine%basis == basis_ddmp) then
        call dual_ends(engine%grid, at, low, high)
        call make_dual_list(d, p%p(l, :d, c), low, high, engine%dual_alpha, list)
        return
      end if
      spline = make_spline(spline_degree(engine%basis), engine%grid, at)
      half = engine%overlap*p%uniform_half
      if (p%half_length%first > 0) half(:d) = engine%overlap*p%p(l, p%half_length%first:p%half_length%first + d - 1, c)
      q = p%domain%first
      if (engine%basis == basis_cpgimp) half(:d) = p%p(l, q:q + d - 1, c)
      if (engine%basis == basis_linear) half = 0.0_wp
      call make_weight_list(d, p%p(l, :d, c), half, spline, list)
    end associate
  end subroutine particle_list

  !> The same of a domain that is sampled at points
  pure subroutine sampled_list(engine, c, l, list)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: c, l
    type(weight_list_t), intent(inout) :: list
    real(wp) :: volume(lanes), at(lanes, engine%grid%dim, engine%rule%n), by(lanes, engine%grid%dim, engine%rule%n), share(lanes, engine%rule%n)
    associate (p => engine%particles%p(:, :, c), rule => engine%rule, q => engine%particles%domain%first, d => engine%grid%dim)
      if (rule%carried /= carried_none) then
        associate (corner => engine%particles%corner%first)
          select case (d)
          case (1); call place_corners_1d(rule%carried, rule%n, p(1, corner), at, share, by, volume)
          case (2); call place_corners_2d(rule%carried, rule%n, p(1, corner), at, share, by, volume)
          case (3); call place_corners_3d(rule%carried, rule%n, p(1, corner), at, share, by, volume)
          end select
        end associate
        call make_point_list(d, rule%n, .false., at(l, :, :), share(l, :), by(l, :, :), list)
        return
      end if
      select case (d)
      case (1); call place_points_1d(rule%n, rule%c, rule%w, rule%q, p(1, 1), p(1, q), at, share, by)
      case (2); call place_points_2d(rule%n, rule%c, rule%w, rule%q, p(1, 1), p(1, q), at, share, by)
      case (3); call place_points_3d(rule%n, rule%c, rule%w, rule%q, p(1, 1), p(1, q), at, share, by)
      end select
      call make_point_list(d, rule%n, rule%by_gradient, at(l, :, :), share(l, :), by(l, :, :), list)
    end associate
  end subroutine sampled_list

end module gimp_particle_list
