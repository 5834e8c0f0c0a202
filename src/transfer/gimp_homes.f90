!> Where particles are at home: the block of the support of each lane of a chunk, and its cell there
module gimp_homes
  use gimp_kinds, only: wp, lanes
  use gimp_dual_domain, only: dual_reach
  use gimp_basis, only: basis_linear, basis_cpgimp, basis_bspline2, basis_bspline3, basis_cpdi, basis_cpdi2, basis_gauss, basis_ddmp, narrow_half
  use gimp_patches, only: cell_of_element
  use gimp_engine, only: engine_t
  implicit none(type, external)
  private
  public :: shift_chunk

contains

  !> How many blocks each lane of a chunk has moved, and the cell it is now in; positions become relative to the new block
  subroutine shift_chunk(engine, at, components, p, off, cell)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: at(3), components
    real(wp), intent(inout) :: p(lanes, components)
    integer, intent(inout) :: off(lanes, 3)
    integer, intent(out) :: cell(lanes)
    real(wp) :: half(lanes), x(lanes), back(lanes), edge
    integer :: k, l, stride, wrap, in_edge, q
    if (engine%grid%is_mesh) then
      call shift_in_mesh(engine, at(1), p(:, engine%particles%element%first), off(:, 1), cell)
      return
    end if
    cell = 0
    stride = 1
    do k = 1, engine%grid%dim
      in_edge = engine%grid%edge(k)
      edge = in_edge
      x = p(:, k)
      back = 0.0_wp
      if (engine%grid%periodic(k)) then
        do l = 1, lanes
          wrap = floor(x(l)) + at(k)*in_edge
          wrap = (wrap - modulo(wrap, engine%grid%cells(k)))/engine%grid%cells(k)
          if (wrap /= 0) back(l) = wrap*engine%grid%cells(k)
          if (wrap /= 0) x(l) = x(l) - back(l)
        end do
      end if
      select case (engine%basis)
      case (basis_linear)
        half = 0.0_wp
      case (basis_cpdi, basis_cpdi2, basis_gauss) ! their pads have room for so much on all sides
        half = narrow_half
      case (basis_ddmp)
        half = dual_reach
      case (basis_bspline2, basis_bspline3) ! as spline_reach
        half = merge(0.5_wp, 1.0_wp, engine%basis == basis_bspline2 .and. engine%grid%open_degree == 0)
      case default
        q = engine%particles%half_length%first
        if (engine%basis == basis_cpgimp) q = engine%particles%domain%first
        half = engine%overlap*engine%particles%uniform_half(k)
        if (q > 0) half = p(:, q + k - 1)
        if (q == engine%particles%half_length%first .and. q > 0) half = engine%overlap*half
        half = min(narrow_half, half)
      end select
      !$omp simd
      do l = 1, lanes
        off(l, k) = floor((x(l) - half(l))/edge) ! exact: edges are powers of two
        x(l) = x(l) - off(l, k)*edge
        ! shifting by whole blocks may round a position onto a face: it stays in its block
        cell(l) = cell(l) + stride*min(in_edge - 1, max(0, floor(x(l) - half(l))))
      end do
      p(:, k) = x
      call shift_corners(engine, k, back + off(:, k)*edge, components, p)
      stride = stride*in_edge
    end do
  end subroutine shift_chunk

  !> The same in a mesh, where a particle knows its element, and positions do not refer to patches
  pure subroutine shift_in_mesh(engine, patch, element, off, cell)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: patch
    real(wp), intent(in) :: element(lanes)
    integer, intent(inout) :: off(lanes)
    integer, intent(out) :: cell(lanes)
    integer :: l, e
    do l = 1, lanes
      e = min(max(1, nint(abs(element(l)))), engine%mesh%elements) ! spare lanes may hold anything
      off(l) = engine%patches%of_element(e) - patch
      cell(l) = cell_of_element(engine%patches, engine%patches%of_element(e), e)
    end do
  end subroutine shift_in_mesh

  !> Corners of domains go with their particle: whole cells, which is exact
  pure subroutine shift_corners(engine, k, back, components, p)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: k, components !! k: axis
    real(wp), intent(in) :: back(lanes) !! [cells]
    real(wp), intent(inout) :: p(lanes, components)
    integer :: q
    associate (corner => engine%particles%corner)
      do q = corner%first + k - 1, corner%first + corner%components - 1, engine%grid%dim
        p(:, q) = p(:, q) - back
      end do
    end associate
  end subroutine shift_corners

end module gimp_homes
