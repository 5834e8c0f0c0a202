!> Sort: every particle goes to the block of its support, in the order block, material, cell, id, and the tables of active
!> blocks are built anew. Sorts happen rarely and are decided for the whole run at once.
module gimp_resort
  use gimp_kinds, only: wp, i8, lanes
  use gimp_grid, only: block_key, nodes_per_block
  use gimp_blocks, only: build_blocks
  use gimp_images, only: images_wanted, build_images
  use gimp_hash_table, only: hash_table_t, clear_table, insert_key
  use gimp_sorting, only: sort_order
  use gimp_particles, only: particles_t, group_t, allot_chunks, swap_chunks
  use gimp_basis, only: basis_linear, basis_cpgimp, basis_bspline2, basis_bspline3, narrow_half
  use gimp_engine, only: engine_t, allot_grid
  implicit none(type, external)
  private
  public :: sort_particles

contains

  !> Sort all particles; those marked in `remove` (by chunk and lane) are dropped
  subroutine sort_particles(engine, remove)
    type(engine_t), intent(inout) :: engine
    logical, intent(in), optional :: remove(:, :) !! (lane, chunk)
    integer, allocatable :: bin(:, :), at(:, :), block_at(:, :), home(:, :), source(:), first_in_bin(:), extra(:, :)
    integer :: bins, places

    call assign_blocks(engine, remove, home, block_at)
    call images_wanted(engine%grid, block_at, extra)
    at = block_at
    call build_blocks(engine%table, engine%grid, at, extra)
    call build_images(engine%grid, engine%table, engine%images)
    call assign_bins(engine, home, bin)
    bins = engine%table%blocks*size(engine%laws)*nodes_per_block
    call count_bins(engine, bin, bins, first_in_bin, places)
    call place_particles(engine, bin, first_in_bin, places, source)
    call move_particles(engine, source, places)
    call allot_grid(engine)
  end subroutine sort_particles

  !> Coordinate of the lowest node that a particle's narrow support touches, along one axis, in cells from the box corner
  pure integer function support_base(engine, c, l, k, block_at) result(base)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: c, l, k, block_at
    real(wp) :: x
    x = engine%particles%p(l, k, c)
    select case (engine%basis)
    case (basis_linear)
      continue
    case (basis_bspline2, basis_bspline3) ! as spline_reach
      x = x - merge(0.5_wp, 1.0_wp, engine%basis == basis_bspline2 .and. engine%grid%open_degree == 0)
    case (basis_cpgimp)
      x = x - min(narrow_half, engine%particles%p(l, engine%particles%domain%first + k - 1, c))
    case default
      if (engine%particles%half_length%first > 0) then
        x = x - min(narrow_half, engine%particles%p(l, engine%particles%half_length%first + k - 1, c))
      else
        x = x - min(narrow_half, engine%particles%uniform_half(k))
      end if
    end select
    base = floor(x) + block_at*engine%grid%edge(k)
  end function support_base

  !> The block of every particle: `home` is its number in `block_at`, which ascends by key; 0 for spare lanes.
  !> Positions wrap around periodic axes here.
  subroutine assign_blocks(engine, remove, home, block_at)
    type(engine_t), intent(inout) :: engine
    logical, intent(in), optional :: remove(:, :)
    integer, allocatable, intent(out) :: home(:, :), block_at(:, :)
    type(hash_table_t) :: table
    integer, allocatable :: found(:, :), wider(:, :), order(:), rank(:)
    integer(i8), allocatable :: keys(:)
    integer(i8) :: key, last_key
    integer :: g, c, l, k, n, base(3), at(3), here(3), last, wrap, value

    associate (particles => engine%particles, grid => engine%grid)
      allocate (home(lanes, particles%chunks), source=0)
      allocate (found(3, 64))
      call clear_table(table, max(64, engine%table%blocks))
      n = 0
      last = 0
      last_key = -1
      do g = 1, size(particles%groups)
        here = particles%groups(g)%at
        do c = particles%groups(g)%first, particles%groups(g)%last
          do l = 1, lanes
            if (particles%id(l, c) == 0) cycle
            if (present(remove)) then
              if (remove(l, c)) cycle
            end if
            at = 0
            do k = 1, grid%dim
              if (grid%periodic(k)) then
                wrap = floor(particles%p(l, k, c)) + here(k)*grid%edge(k)
                wrap = (wrap - modulo(wrap, grid%cells(k)))/grid%cells(k)
                if (wrap /= 0) particles%p(l, k, c) = particles%p(l, k, c) - wrap*grid%cells(k)
              end if
              base(k) = support_base(engine, c, l, k, here(k))
              at(k) = (base(k) - modulo(base(k), grid%edge(k)))/grid%edge(k)
            end do
            key = block_key(at)
            if (key /= last_key) then
              call insert_key(table, key, n + 1, value)
              if (value > n) then
                if (n == size(found, 2)) then
                  allocate (wider(3, 2*n))
                  wider(:, :n) = found
                  call move_alloc(wider, found)
                end if
                n = n + 1
                found(:, n) = at
              end if
              last = value
              last_key = key
            end if
            home(l, c) = last
          end do
        end do
      end do
    end associate
    allocate (keys(n), rank(0:n))
    do k = 1, n
      keys(k) = block_key(found(:, k))
    end do
    call sort_order(keys, order)
    block_at = found(:, order)
    rank(0) = 0
    do k = 1, n
      rank(order(k)) = k
    end do
    do c = 1, size(home, 2)
      home(:, c) = rank(home(:, c))
    end do
  end subroutine assign_blocks

  !> Bin of every particle: (block, material, cell); positions become relative to the new block
  subroutine assign_bins(engine, home, bin)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: home(:, :)
    integer, allocatable, intent(out) :: bin(:, :)
    integer :: g, c, l, k, cell(3), b, m, base, old_at(3)
    allocate (bin(lanes, engine%particles%chunks), source=0)
    associate (particles => engine%particles, grid => engine%grid)
      do g = 1, size(particles%groups)
        m = particles%groups(g)%material
        old_at = particles%groups(g)%at
        do c = particles%groups(g)%first, particles%groups(g)%last
          do l = 1, lanes
            b = home(l, c)
            if (b == 0) cycle
            cell = 0
            do k = 1, grid%dim
              particles%p(l, k, c) = particles%p(l, k, c) + (old_at(k) - engine%table%block_at(k, b))*grid%edge(k)
              base = support_base(engine, c, l, k, 0)
              ! shifting by whole cells may round a position onto a face: it stays in its block
              cell(k) = min(grid%edge(k) - 1, max(0, base))
            end do
            bin(l, c) = 1 + cell(1) + grid%edge(1)*(cell(2) + grid%edge(2)*cell(3)) &
              + nodes_per_block*(m - 1 + size(engine%laws)*(b - 1))
          end do
        end do
      end do
    end associate
  end subroutine assign_bins

  !> Count the particles of every bin; groups and where each bin starts, in lanes of the new chunks
  subroutine count_bins(engine, bin, bins, first_in_bin, places)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: bin(:, :), bins
    integer, allocatable, intent(out) :: first_in_bin(:)
    integer, intent(out) :: places !! lanes of all new chunks
    integer, allocatable :: count(:)
    type(group_t), allocatable :: groups(:)
    integer :: c, l, b, m, k, n, laws, in_group
    allocate (count(bins), first_in_bin(bins), source=0)
    do c = 1, size(bin, 2)
      do l = 1, lanes
        if (bin(l, c) > 0) count(bin(l, c)) = count(bin(l, c)) + 1
      end do
    end do
    laws = size(engine%laws)
    allocate (groups(engine%table%blocks*laws))
    if (allocated(engine%particles%block_group)) deallocate (engine%particles%block_group)
    allocate (engine%particles%block_group(engine%table%blocks + 1))
    n = 0
    places = 0
    do b = 1, engine%table%blocks
      engine%particles%block_group(b) = n + 1
      do m = 1, laws
        in_group = 0
        do k = (m - 1 + laws*(b - 1))*nodes_per_block + 1, (m + laws*(b - 1))*nodes_per_block
          first_in_bin(k) = places + in_group
          in_group = in_group + count(k)
        end do
        if (in_group == 0) cycle
        n = n + 1
        groups(n)%block = b
        groups(n)%material = m
        groups(n)%at = engine%table%block_at(:, b)
        groups(n)%first = places/lanes + 1
        places = places + (in_group + lanes - 1)/lanes*lanes
        groups(n)%last = places/lanes
      end do
    end do
    engine%particles%block_group(engine%table%blocks + 1) = n + 1
    engine%particles%groups = groups(:n)
  end subroutine count_bins

  !> The source lane of every new lane (0: spare); within a bin by id, so that the order never depends on history
  subroutine place_particles(engine, bin, first_in_bin, places, source)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: bin(:, :), places
    integer, intent(inout) :: first_in_bin(:)
    integer, allocatable, intent(out) :: source(:)
    integer, allocatable :: filled(:)
    integer(i8) :: id
    integer :: c, l, k, q, to
    allocate (source(0:max(places, 1) - 1), source=0)
    allocate (filled(size(first_in_bin)), source=0)
    do c = 1, size(bin, 2)
      do l = 1, lanes
        k = bin(l, c)
        if (k == 0) cycle
        id = engine%particles%id(l, c)
        to = first_in_bin(k) + filled(k)
        q = to
        do while (q > first_in_bin(k)) ! insertion by id: nearly always already in place
          if (id_of(source(q - 1)) < id) exit
          source(q) = source(q - 1)
          q = q - 1
        end do
        source(q) = (c - 1)*lanes + l
        filled(k) = filled(k) + 1
      end do
    end do

  contains

    integer(i8) function id_of(place)
      integer, intent(in) :: place
      id_of = engine%particles%id(modulo(place - 1, lanes) + 1, (place - 1)/lanes + 1)
    end function id_of

  end subroutine place_particles

  !> Carry every field to its new place
  subroutine move_particles(engine, source, places)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: places
    integer, intent(in) :: source(0:max(places, 1) - 1)
    integer :: chunks
    chunks = places/lanes
    call allot_chunks(engine%particles, chunks)
    associate (particles => engine%particles)
      call copy_lanes(particles%components, particles%chunks, chunks, source, particles%p, particles%id, particles%spare, &
                      particles%spare_id)
      call fill_spare_lanes(particles, chunks, particles%spare, particles%spare_id)
    end associate
    call swap_chunks(engine%particles)
    engine%particles%n = count(engine%particles%id > 0, kind=i8)
  end subroutine move_particles

  subroutine copy_lanes(components, old_chunks, chunks, source, old, old_id, new, new_id)
    integer, intent(in) :: components, old_chunks, chunks, source(0:lanes*chunks - 1)
    real(wp), intent(in) :: old(lanes, components, old_chunks)
    integer(i8), intent(in) :: old_id(lanes, old_chunks)
    real(wp), intent(inout) :: new(lanes, components, chunks)
    integer(i8), intent(inout) :: new_id(lanes, chunks)
    integer :: c, l, f, from(lanes), at(lanes)
    !$omp parallel do schedule(static) private(l, f, from, at)
    do c = 1, chunks
      do l = 1, lanes
        from(l) = max(0, source((c - 1)*lanes + l - 1) - 1)
        at(l) = from(l)/lanes + 1
        new_id(l, c) = merge(old_id(modulo(from(l), lanes) + 1, at(l)), 0_i8, source((c - 1)*lanes + l - 1) > 0)
        from(l) = modulo(from(l), lanes) + 1
      end do
      do l = 1, lanes
        do f = 1, components
          new(l, f, c) = old(from(l), f, at(l))
        end do
      end do
    end do
    !$omp end parallel do
  end subroutine copy_lanes

  !> Spare lanes hold a twin of the chunk's first particle, without mass, volume and force
  pure subroutine fill_spare_lanes(particles, chunks, p, id)
    type(particles_t), intent(in) :: particles
    integer, intent(in) :: chunks
    real(wp), intent(inout) :: p(lanes, particles%components, chunks)
    integer(i8), intent(in) :: id(lanes, chunks)
    integer :: c, l, q
    do c = 1, chunks
      do l = 1, lanes
        if (id(l, c) > 0) cycle
        p(l, :, c) = p(1, :, c) ! lane 1 is never spare: a twin of it moves as a real particle does, and weighs nothing
        p(l, particles%mass%first, c) = 0.0_wp
        p(l, particles%volume%first, c) = 0.0_wp
        if (particles%force%first > 0) then
          q = particles%force%first
          p(l, q:q + particles%dim - 1, c) = 0.0_wp
        end if
        if (particles%faces%first > 0) p(l, particles%faces%first, c) = 0.0_wp
      end do
    end do
  end subroutine fill_spare_lanes

end module gimp_resort
