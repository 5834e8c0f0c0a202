!> Sums over the cells of the grid: every particle gives up to eight numbers to the cell it lies in, and later takes the sums of it.
!>
!> A cell is known by the node at its low corner, so that cells have the blocks, pads and slots of nodes: a block collects in its
!> pad, slots add the pads around them in a fixed order. A particle may have drifted into the cell of a neighbour block. Cells
!> are half open; a particle beyond a side of the box belongs to the last cell before it, unless the axis is periodic.
module gimp_cells
  use gimp_kinds, only: wp, lanes
  use gimp_grid, only: nodes_per_block, nf => fields_per_node
  use gimp_blocks, only: neighbour, few_blocks
  use gimp_images, only: fold_images
  use gimp_tensor, only: increment, determinant
  use gimp_kernels, only: to_lanes, to_fields
  use gimp_engine, only: engine_t, pad_edge, drift
  use gimp_pads, only: sum_pads, add_spills
  use gimp_list_kernel, only: add_spill
  use omp_lib, only: omp_get_thread_num
  implicit none(type, external)
  private
  public :: find_cells, give_to_cells, take_from_cells, sum_cells, even_increment, even_rate, even_pressure, even_stress, stress_values

contains

  !> Cells of the lanes of a chunk, relative to the origin of the block at `at`
  pure subroutine find_cells(engine, at, x, cell)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: at(3) !! block coordinates
    real(wp), intent(in) :: x(lanes, engine%grid%dim) !! relative to the block [cells]
    integer, intent(out) :: cell(3, lanes)
    real(wp) :: least, most
    integer :: k, l
    cell = 0
    do k = 1, engine%grid%dim
      least = real(-engine%grid%edge(k), wp) ! where lost particles are put: the pass that follows reports them
      most = real(2*engine%grid%edge(k) - 1, wp)
      if (.not. engine%grid%periodic(k)) then
        least = max(least, real(-at(k)*engine%grid%edge(k), wp))
        most = min(most, real(engine%grid%cells(k) - 1 - at(k)*engine%grid%edge(k), wp))
      end if
      do l = 1, lanes
        cell(k, l) = nint(least)
        if (x(l, k) >= least) cell(k, l) = floor(min(x(l, k), most)) ! NaN is not
      end do
    end do
  end subroutine find_cells

  !> Add `values` of the lanes to their cells, in the pad of the block; beyond it to the spill list of the thread
  subroutine give_to_cells(engine, b, x, values, pad)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: b !! block
    real(wp), intent(in) :: x(lanes, engine%grid%dim) !! positions relative to the block [cells]
    real(wp), intent(in) :: values(lanes, nf)
    real(wp), intent(inout) :: pad(nf, *) !! of the block
    real(wp) :: given(nf, lanes)
    integer :: cell(3, lanes), edge(3), low(3), l, slot, place
    call find_cells(engine, engine%table%block_at(:, b), x, cell)
    call to_fields(values, given)
    edge = pad_edge(engine%grid%dim, engine%basis)
    low = merge(-drift, 0, [1, 2, 3] <= engine%grid%dim)
    do l = 1, lanes
      if (all(cell(:, l) >= low .and. cell(:, l) < low + edge)) then
        place = 1 + cell(1, l) - low(1) + edge(1)*(cell(2, l) - low(2) + edge(2)*(cell(3, l) - low(3)))
        pad(:, place) = pad(:, place) + given(:, l)
      else
        call find_slot(engine, b, cell(:, l), slot, place)
        call add_spill(engine%spilled(1 + omp_get_thread_num()), b, slot, place, given(:, l))
      end if
    end do
  end subroutine give_to_cells

  !> The sums of the cells that the lanes of a chunk lie in
  pure subroutine take_from_cells(engine, b, x, sums)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: b !! block
    real(wp), intent(in) :: x(lanes, engine%grid%dim) !! positions relative to the block [cells]
    real(wp), intent(out) :: sums(lanes, nf)
    real(wp) :: taken(nf, lanes)
    integer :: cell(3, lanes), l, slot, place
    call find_cells(engine, engine%table%block_at(:, b), x, cell)
    do l = 1, lanes
      call find_slot(engine, b, cell(:, l), slot, place)
      taken(:, l) = engine%cell_sum(:, place, slot)
    end do
    call to_lanes(taken, sums)
  end subroutine take_from_cells

  !> Slot of a cell near block b, and its place there
  pure subroutine find_slot(engine, b, cell, slot, place)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: b, cell(3) !! relative to the block
    integer, intent(out) :: slot, place
    integer :: off(3), at(3)
    at = modulo(cell, engine%grid%edge)
    off = (cell - at)/engine%grid%edge
    slot = engine%table%slot_near(neighbour(off(1), off(2), off(3)), b)
    place = 1 + at(1) + engine%grid%edge(1)*(at(2) + engine%grid%edge(2)*at(3))
  end subroutine find_slot

  !> Add up what the blocks collected in their pads; ghosts of periodic sides give to the cells they stand for, and show their sums
  subroutine sum_cells(engine)
    type(engine_t), intent(inout) :: engine
    logical :: whole(engine%table%blocks + engine%table%ghosts)
    integer :: k, slot
    whole = .true.
    !$omp parallel do schedule(static) if(engine%table%slots > few_blocks)
    do slot = 1, engine%table%slots
      call sum_pads(engine, slot, engine%cell_sum(:, :, slot), whole)
    end do
    !$omp end parallel do
    call add_spills(engine, engine%table%slots, engine%cell_sum)
    engine%spill%n = 0
    if (.not. any(engine%grid%periodic)) return
    call fold_images(engine%images, engine%table%slots, engine%cell_sum) ! nobody gave to cells behind a mirror
    do k = 1, size(engine%images)
      associate (i => engine%images(k))
        engine%cell_sum(:, i%place, i%slot) = engine%cell_sum(:, i%target_place, i%target_slot)
      end associate
    end do
  end subroutine sum_cells

  !> F-bar (de Souza Neto et al. 1996; particles of a cell: Coombs et al. 2018): dFb = (dJ_c/det dF)^(1/d) dF on the components of
  !> the d dimensions, dJ_c = sum V det dF/sum V; and the velocity gradient that goes with it
  pure subroutine even_increment(dim, dt, sums, l, df, l_even, df_even)
    integer, intent(in) :: dim
    real(wp), intent(in) :: dt !! step [s]
    real(wp), intent(in) :: sums(lanes, nf) !! of the cell: V [m3], V det dF
    real(wp), intent(in) :: l(lanes, 9), df(lanes, 9) !! velocity gradient [1/s], increment of F
    real(wp), intent(out) :: l_even(lanes, 9), df_even(lanes, 9)
    real(wp) :: j(lanes), ratio, factor
    integer :: i, k, q
    call determinant(df, j)
    l_even = l
    df_even = df
    do i = 1, lanes
      if (.not. (j(i) > 0.0_wp .and. j(i) <= huge(1.0_wp) .and. sums(i, 1) > 0.0_wp .and. sums(i, 2) > 0.0_wp)) cycle ! the caller checks F
      ratio = sums(i, 2)/(sums(i, 1)*j(i))
      factor = ratio**(1.0_wp/dim)
      do k = 1, dim
        do q = 1, dim
          df_even(i, 3*(k - 1) + q) = factor*df(i, 3*(k - 1) + q)
        end do
        l_even(i, 4*k - 3) = l(i, 4*k - 3) + log(ratio)/(dim*dt)
      end do
    end do
  end subroutine even_increment

  !> B-bar: Lb = L + (tr L_c - tr L)/d on the diagonal, tr L_c = sum V tr L/sum V
  pure subroutine even_rate(dim, dt, rule, sums, l, l_even, df_even)
    integer, intent(in) :: dim, rule !! how increments are made of rates
    real(wp), intent(in) :: dt !! step [s]
    real(wp), intent(in) :: sums(lanes, nf) !! of the cell: V [m3], V tr L
    real(wp), intent(in) :: l(lanes, 9) !! velocity gradient [1/s]
    real(wp), intent(out) :: l_even(lanes, 9), df_even(lanes, 9)
    real(wp) :: more
    integer :: i, k
    l_even = l
    do i = 1, lanes
      if (.not. sums(i, 1) > 0.0_wp) cycle
      more = (sums(i, 2)/sums(i, 1) - (l(i, 1) + l(i, 5) + l(i, 9)))/dim
      do k = 1, dim
        l_even(i, 4*k - 3) = l(i, 4*k - 3) + more
      end do
    end do
    call increment(rule, dt, l_even, df_even)
  end subroutine even_rate

  !> What a particle gives to its cell for the stress of the next force: V, then V sigma, all of it or its mean over the d dimensions
  pure subroutine stress_values(dim, whole, volume, j, tau, values)
    integer, intent(in) :: dim
    logical, intent(in) :: whole
    real(wp), intent(in) :: volume(lanes), j(lanes), tau(lanes, 6) !! before deformation [m3], det F, Kirchhoff stress [Pa]
    real(wp), intent(out) :: values(lanes, nf)
    integer :: k
    values = 0.0_wp
    values(:, 1) = volume*j
    if (whole) then
      do k = 1, 6
        values(:, 1 + k) = volume*tau(:, k)
      end do
    else
      values(:, 2) = volume*sum(tau(:, :dim), dim=2)/dim
    end if
  end subroutine stress_values

  !> The adjoint of `even_rate`: the mean stress over the d dimensions becomes that of the cell, weighted by volume, so that forces
  !> on nodes do the work sum V sigma : Lb
  pure subroutine even_pressure(dim, sums, j, tau)
    integer, intent(in) :: dim
    real(wp), intent(in) :: sums(lanes, nf), j(lanes) !! of the cell: V, V times the mean stress; det F
    real(wp), intent(inout) :: tau(lanes, 6) !! Kirchhoff stress [Pa]
    real(wp) :: more
    integer :: i, k
    do i = 1, lanes
      if (.not. sums(i, 1) > 0.0_wp) cycle
      more = j(i)*sums(i, 2)/sums(i, 1) - sum(tau(i, :dim))/dim
      do k = 1, dim
        tau(i, k) = tau(i, k) + more
      end do
    end do
  end subroutine even_pressure

  !> Reduced integration (Andersen & Andersen 2010): the stress of the cell, sum V sigma/sum V, for that of the particle
  pure subroutine even_stress(sums, j, tau)
    real(wp), intent(in) :: sums(lanes, nf), j(lanes) !! of the cell: V, V sigma; det F
    real(wp), intent(inout) :: tau(lanes, 6) !! Kirchhoff stress [Pa]
    integer :: i, k
    do k = 1, 6
      do i = 1, lanes
        if (sums(i, 1) > 0.0_wp) tau(i, k) = j(i)*sums(i, 1 + k)/sums(i, 1)
      end do
    end do
  end subroutine even_stress

end module gimp_cells
