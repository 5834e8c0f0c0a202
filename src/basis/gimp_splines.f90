!> Weights of quadratic and cubic B-splines on equal knots, and of their form with open knots at the sides of the box
!> (Steffen, Kirby & Berzins 2008). Lengths in cells.
!>
!> Ghost form: function i is centred at node i, nodes beyond the box are ordinary nodes; the quadratic has its knots half-way
!> between nodes, the cubic on nodes. Open form: knots on nodes, those at the ends of the box degree + 1 times; an axis of n
!> cells has n + degree functions, which the grid stores at nodes -1 ... n + degree - 2. The first and the last one are 1 on
!> their side. What counts as the position of a function is its Greville abscissa, the mean of its inner knots.
module gimp_splines
  use gimp_kinds, only: wp
  use gimp_grid, only: grid_t
  implicit none(type, external)
  private
  public :: spline_t, make_spline, spline_reach, spline_weights, node_place, most_degree

  integer, parameter :: most_degree = 3
  real(wp), parameter :: nowhere = 1.0e6_wp !! knots end beyond any node of a block

  !> A spline in the coordinates of a block; degree 0 stands for the bases that are none
  type :: spline_t
    integer :: degree = 0
    logical :: open = .false.
    real(wp) :: shift = 0.0_wp !! knots lie this much below whole cells
    real(wp) :: low(3) = -nowhere, high(3) = nowhere !! where knots end: the sides of the box
  end type spline_t

contains

  !> The spline as the block at `at` sees it
  pure type(spline_t) function make_spline(degree, grid, at) result(spline)
    integer, intent(in) :: degree !! 2, 3, or 0 for none
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: at(3) !! coordinates of the block that positions refer to
    spline%degree = degree
    if (degree == 0) return
    spline%open = grid%open_degree > 0
    if (spline%open) then
      spline%low = -real(at*grid%edge, wp)
      spline%high = real(grid%cells - at*grid%edge, wp)
    else if (degree == 2) then
      spline%shift = 0.5_wp
    end if
  end function make_spline

  !> The support of a particle at x begins at node floor(x - reach); 0 for bases that are no spline
  pure real(wp) function spline_reach(spline)
    type(spline_t), intent(in) :: spline
    spline_reach = 0.0_wp
    if (spline%degree > 0) spline_reach = 1.0_wp - spline%shift
  end function spline_reach

  !> Weights and gradients [1/spacing] along axis k of nodes first ... first + degree: the recursion of Cox and de Boor (Piegl &
  !> Tiller, The NURBS Book, algorithm A2.2), whose denominators never vanish
  pure subroutine spline_weights(spline, k, x, first, n, s, g)
    type(spline_t), intent(in) :: spline
    integer, intent(in) :: k !! axis
    real(wp), intent(in) :: x !! position [cells]
    integer, intent(out) :: first, n
    real(wp), intent(out) :: s(:), g(:) !! (degree + 1 or more)
    real(wp) :: b, left(most_degree), right(most_degree), part, saved, cell
    integer :: j, r, p
    p = spline%degree
    n = p + 1
    s = 0.0_wp
    g = 0.0_wp
    first = floor(x - spline_reach(spline))
    cell = real(first + 1, wp)
    cell = min(max(cell, spline%low(k)), spline%high(k) - 1.0_wp) ! a point on the last side belongs to the last cell
    first = nint(cell) - 1
    b = x + spline%shift - cell
    do j = 1, p ! distances to the knots below and above
      left(j) = b - max(real(1 - j, wp), spline%low(k) - cell)
      right(j) = min(real(j, wp), spline%high(k) - cell) - b
    end do
    s(1) = 1.0_wp
    do j = 1, p
      saved = 0.0_wp
      do r = 1, j
        part = s(r)/(right(r) + left(j - r + 1))
        if (j == p) then
          g(r) = g(r) - p*part
          g(r + 1) = p*part
        end if
        s(r) = saved + right(r)*part
        saved = left(j - r + 1)*part
      end do
      s(j + 1) = saved
    end do
  end subroutine spline_weights

  !> Where a node stands for linear fields and moments [cells]: its Greville abscissa, or the node itself
  pure real(wp) function node_place(spline, k, node) result(x)
    type(spline_t), intent(in) :: spline
    integer, intent(in) :: k, node !! axis, node coordinate
    integer :: j
    x = real(node, wp)
    if (.not. spline%open) return
    x = 0.0_wp
    do j = 1, spline%degree
      x = x + min(max(real(node + j - spline%degree + 1, wp), spline%low(k)), spline%high(k))
    end do
    x = x/spline%degree
  end function node_place

end module gimp_splines
