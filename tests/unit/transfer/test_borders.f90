!> Particles and pads that cross borders of ranks: after each sort every particle is on the owner of its block, once, with all that it
!> stores; groups and chunks are those of one rank alone; nodes that a rank books have the sum of all pads.
!>
!> All ranks know the cloud; what the others hold is heard by adding up words of which all but one rank have zero.
program test_borders
  use gimp_kinds, only: wp, i8, lanes
  use gimp_text, only: text_of
  use gimp_grid, only: block_key, block_at_key, nodes_per_block, nf => fields_per_node
  use gimp_sorting, only: rank_keys, sort_order
  use gimp_hash_table, only: find_key
  use gimp_ranks, only: this_rank, ranks, backend, start_ranks, end_ranks, sum_words
  use gimp_over_ranks, only: any_rank, sum_counts
  use gimp_cuts, only: is_mine
  use gimp_border, only: repartition_balanced, repartition_always, repartition_never
  use gimp_basis, only: basis_linear, basis_ugimp, basis_bspline3
  use gimp_homes, only: shift_chunk
  use gimp_engine, only: engine_t, pass_t, pad_edge, drift
  use gimp_resort, only: sort_particles
  use gimp_particle_pass, only: particle_pass
  use gimp_pads, only: sum_pads
  use gimp_engine_fixture, only: cloud_t, random_cloud, make_engine, random_reals
  use gimp_check, only: begin_suite, suite_failed, check, check_true
  implicit none(type, external)

  integer, parameter :: particles = 300, rounds = 3
  integer :: seed = 77, dim, kind

  call start_ranks()
  call begin_suite("borders, "//trim(backend)//", "//text_of(this_rank)//" of "//text_of(ranks))
  do dim = 1, 3
    do kind = repartition_balanced, repartition_never
      call test_rounds(dim, basis_ugimp, kind, .false.)
    end do
    call test_rounds(dim, basis_linear, repartition_always, .true.)
    call test_rounds(dim, basis_bspline3, repartition_balanced, .true.)
    call test_rounds(dim, basis_bspline3, repartition_never, .false.)
  end do
  call test_lone()
  call end_ranks(merge(1, 0, any_rank(suite_failed())))

contains

  !> A cloud that spreads and whose particles jump by up to half a block between sorts; some are taken out
  subroutine test_rounds(dim, basis, kind, periodic)
    integer, intent(in) :: dim, basis, kind
    logical, intent(in) :: periodic
    type(engine_t), target :: engine
    type(cloud_t) :: cloud
    character(len=:), allocatable :: which
    logical, allocatable :: remove(:, :)
    logical :: there(particles)
    integer :: round, cells(3)
    real(wp) :: high(3)
    cells = 1
    cells(:dim) = merge(333, merge(45, 14, dim == 2), dim == 1)
    high = 0.0_wp
    high(:dim) = cells(:dim)
    call random_cloud(dim, particles, [0.0_wp, 0.0_wp, 0.0_wp], high, 0.1_wp, 0.4_wp, seed, cloud)
    cloud%material(::3) = 2
    cloud%id = [(int(modulo(8*round, particles + 1), i8), round=1, particles)] ! 8 and 301 have no factor in common: each once
    call make_engine(dim, basis, cells, 1.0_wp, cloud, engine)
    engine%grid%periodic(:dim) = periodic
    engine%border%repartition = kind
    engine%border%most_imbalance = 1.01
    call keep_share(engine, cloud)
    there = .true.
    do round = 1, rounds
      which = ", "//text_of(dim)//"D, basis "//text_of(basis)//", repartition "//text_of(kind)//", round "//text_of(round)
      if (round == 2) then ! everyone with a number that 5 divides goes
        remove = modulo(engine%particles%id, 5_i8) == 0 .and. engine%particles%id > 0
        where (modulo(cloud%id, 5_i8) == 0) there(int(cloud%id)) = .false.
        call sort_particles(engine, remove)
      else
        call sort_particles(engine)
      end if
      call check_particles(engine, cloud, there, which)
      call check_groups(engine, which)
      call check_pads(engine, which)
      call let_jump(engine)
    end do
    if (kind == repartition_always .and. ranks > 1 .and. dim > 1) call check_true(sum_counts(engine%border%moved_words) > 0, "blocks changed hands"//which)
    if (ranks > 1) call check_true(sum_counts(engine%border%migrated) > 0, "particles changed hands"//which)
  end subroutine test_rounds

  !> One particle on all ranks: the others have nothing, and it goes from one to the other
  subroutine test_lone()
    type(engine_t), target :: engine
    type(cloud_t) :: cloud
    integer :: round
    call random_cloud(2, 1, [1.0_wp, 1.0_wp, 0.0_wp], [2.0_wp, 2.0_wp, 0.0_wp], 0.2_wp, 0.3_wp, seed, cloud)
    call make_engine(2, basis_ugimp, [80, 80, 1], 1.0_wp, cloud, engine)
    engine%border%repartition = repartition_always
    call keep_share(engine, cloud)
    do round = 1, 8
      call sort_particles(engine)
      call check_particles(engine, cloud, [.true.], ", one particle")
      call check_groups(engine, ", one particle")
      call check_pads(engine, ", one particle")
      if (engine%particles%chunks > 0) engine%particles%p(:, 1:2, :) = engine%particles%p(:, 1:2, :) + 7.5_wp
    end do
  end subroutine test_lone

  !> Each rank begins with some of the particles, wherever they are; the last rank with none if there are several
  subroutine keep_share(engine, cloud)
    type(engine_t), intent(inout) :: engine
    type(cloud_t), intent(in) :: cloud
    integer :: holders
    holders = max(1, ranks - 1)
    where (modulo(engine%particles%id, int(holders, i8)) /= this_rank) engine%particles%id = 0
    engine%particles%n = count(engine%particles%id > 0)
    engine%particles%n_all = cloud%n
  end subroutine keep_share

  !> Move every particle, by what its number and place say: no rank needs to know of the others. The reference stays.
  subroutine let_jump(engine)
    type(engine_t), intent(inout) :: engine
    integer :: g, c, l, k
    real(wp) :: u(3), x
    integer :: mark
    do g = 1, size(engine%particles%groups)
      do c = engine%particles%groups(g)%first, engine%particles%groups(g)%last
        do l = 1, lanes
          if (engine%particles%id(l, c) == 0) cycle
          mark = 1 + int(engine%particles%id(l, c))*1009
          call random_reals(mark, u)
          call random_reals(mark, u)
          do k = 1, engine%grid%dim
            x = engine%particles%p(l, k, c) + 0.5_wp*u(k)*engine%grid%edge(k)
            if (.not. engine%grid%periodic(k)) then ! stay in the box
              x = max(0.5_wp - engine%particles%groups(g)%at(k)*engine%grid%edge(k), x)
              x = min(engine%grid%cells(k) - 0.5_wp - engine%particles%groups(g)%at(k)*engine%grid%edge(k), x)
            end if
            engine%particles%p(l, k, c) = x
          end do
        end do
      end do
    end do
  end subroutine let_jump

  !> Every particle that is there stands on one rank, which owns its block, at its place, with all that it stores
  subroutine check_particles(engine, cloud, there, which)
    type(engine_t), intent(in) :: engine
    type(cloud_t), intent(in) :: cloud
    logical, intent(in) :: there(:) !! (id)
    character(len=*), intent(in) :: which
    integer(i8) :: seen(size(there))
    integer :: of_id(size(there)), g, c, l, i, d, wrong(4)
    d = engine%grid%dim
    do i = 1, cloud%n
      of_id(int(cloud%id(i))) = i
    end do
    seen = 0
    wrong = 0
    associate (p => engine%particles)
      do g = 1, size(p%groups)
        if (ranks > 1) then
          if (.not. is_mine(engine%border%cut, block_key(p%groups(g)%at))) wrong(1) = wrong(1) + 1
        end if
        do c = p%groups(g)%first, p%groups(g)%last
          do l = 1, lanes
            if (p%id(l, c) == 0) cycle
            i = of_id(int(p%id(l, c)))
            seen(int(p%id(l, c))) = seen(int(p%id(l, c))) + 1
            if (p%groups(g)%material /= cloud%material(i)) wrong(2) = wrong(2) + 1
            if (any(p%p(l, p%reference%first:p%reference%first + d - 1, c) /= cloud%x(:d, i)) .or. &
                any(p%p(l, p%velocity%first:p%velocity%first + d - 1, c) /= cloud%v(:d, i)) .or. &
                p%p(l, p%mass%first, c) /= cloud%mass(i) .or. p%p(l, p%volume%first, c) /= cloud%volume(i)) wrong(3) = wrong(3) + 1
          end do
        end do
      end do
      call check(wrong(1), 0, "groups are on the owners of their blocks"//which)
      call check(wrong(2), 0, "particles keep their material"//which)
      call check(wrong(3), 0, "and all that they store"//which)
      call check_true(p%n == sum(seen) .and. p%n == count(p%id > 0), "the count of this rank"//which)
      if (ranks > 1) call sum_words(seen)
      call check_true(all(seen == merge(1_i8, 0_i8, there)), "no particle is lost or doubled"//which)
      call check_true(p%n_all == count(there), "the count of all ranks"//which)
    end associate
  end subroutine check_particles

  !> Groups of this rank: blocks ascend, in them materials, in them cells, in them numbers; chunks are full but for the last
  subroutine check_groups(engine, which)
    type(engine_t), intent(in) :: engine
    character(len=*), intent(in) :: which
    integer :: g, c, l, wrong(3), cell(lanes), off(lanes, 3), last_cell, chunk
    integer(i8) :: last_id
    logical :: spare
    real(wp) :: p(lanes, engine%particles%components)
    wrong = 0
    chunk = 0
    associate (groups => engine%particles%groups)
      do g = 1, size(groups)
        if (groups(g)%first /= chunk + 1 .or. groups(g)%last < groups(g)%first) wrong(1) = wrong(1) + 1
        chunk = groups(g)%last
        if (any(groups(g)%at /= engine%table%block_at(:, groups(g)%block))) wrong(1) = wrong(1) + 1
        if (g > 1) then
          if (block_key(groups(g)%at) < block_key(groups(g - 1)%at)) wrong(2) = wrong(2) + 1
          if (all(groups(g)%at == groups(g - 1)%at) .and. groups(g)%material <= groups(g - 1)%material) wrong(2) = wrong(2) + 1
        end if
        last_cell = -1
        last_id = 0
        spare = .false.
        off = 0
        do c = groups(g)%first, groups(g)%last
          if (engine%particles%id(1, c) == 0) wrong(1) = wrong(1) + 1 ! no chunk is empty
          p = engine%particles%p(:, :, c)
          call shift_chunk(engine, groups(g)%at, engine%particles%components, p, off, cell)
          do l = 1, lanes
            if (engine%particles%id(l, c) == 0) then
              spare = .true.
              cycle
            end if
            if (spare .or. any(off(l, :) /= 0)) wrong(3) = wrong(3) + 1 ! spare lanes come last
            if (cell(l) < last_cell .or. (cell(l) == last_cell .and. engine%particles%id(l, c) < last_id)) wrong(3) = wrong(3) + 1
            last_cell = cell(l)
            last_id = engine%particles%id(l, c)
          end do
        end do
      end do
      call check(wrong(1), 0, "chunks of groups"//which)
      call check(chunk, engine%particles%chunks, "all chunks are of groups"//which)
      call check(wrong(2), 0, "the order of groups"//which)
      call check(wrong(3), 0, "the order in groups"//which)
    end associate
  end subroutine check_groups

  !> Pads of all blocks of all ranks, added in the order of blocks around a slot: the sum at each slot, which one rank books
  subroutine check_pads(engine, which)
    type(engine_t), intent(inout) :: engine
    character(len=*), intent(in) :: which
    integer(i8), allocatable :: code(:), booked(:), spills
    real(wp), allocatable :: pad(:, :, :)
    real(wp) :: raw(nf, nodes_per_block), expected(nf, nodes_per_block)
    integer :: s, wrong(2), at
    call particle_pass(engine, pass_t(momentum=.true., force=.true.))
    spills = sum_counts(int(engine%spill%n, i8))
    call check_true(spills == 0, "nothing goes beyond pads in this test"//which)
    call gather_pads(engine, code, pad)
    wrong = 0
    allocate (booked(27*size(code)), source=0_i8)
    associate (table => engine%table)
      do s = 1, table%slots
        call sum_pads(engine, s, raw)
        call add_all(engine, code, pad, table%slot_at(:, s), expected)
        if (table%booked(s) .or. any(engine%images%slot == s) .or. any(engine%images%target_slot == s)) then
          if (any(raw /= expected)) wrong(1) = wrong(1) + 1
        end if
        at = place_of_slot(code, block_key(table%slot_at(:, s)))
        if (at == 0 .and. table%booked(s) .and. any(expected /= 0.0_wp)) wrong(2) = wrong(2) + 1
        if (at > 0 .and. table%booked(s)) booked(at) = booked(at) + 1
      end do
    end associate
    call check(wrong(1), 0, "sums of pads at slots that are booked here, or have images"//which)
    if (ranks > 1) call sum_words(booked)
    call check_true(all(booked == merge(1_i8, 0_i8, [(is_slot(engine%grid%dim, code, s), s=1, size(booked))])), "each slot is booked once"//which)
    call check(wrong(2), 0, "and none that no block is near"//which)
  end subroutine check_pads

  !> Keys of all blocks, ascending, and their pads; nodes that are not in use are zero
  subroutine gather_pads(engine, code, pad)
    type(engine_t), intent(in) :: engine
    integer(i8), allocatable, intent(out) :: code(:)
    real(wp), allocatable, intent(out) :: pad(:, :, :)
    integer(i8), allocatable :: words(:), counts(:)
    integer :: r, first, b, nodes, all_blocks
    allocate (counts(0:ranks - 1), source=0_i8)
    counts(this_rank) = engine%table%blocks
    if (ranks > 1) call sum_words(counts)
    first = int(sum(counts(:this_rank - 1)))
    all_blocks = int(sum(counts))
    allocate (code(all_blocks), source=0_i8)
    code(first + 1:first + engine%table%blocks) = engine%table%block_code(:engine%table%blocks)
    if (ranks > 1) call sum_words(code)
    call check_true(all(code(2:) > code(:all_blocks - 1)), "keys of blocks ascend from rank to rank")
    nodes = product(pad_edge(engine%grid%dim, engine%basis))
    allocate (pad(nf, nodes, all_blocks), source=0.0_wp)
    do b = 1, engine%table%blocks
      pad(:, :, first + b) = engine%pad(:, :, b)
      if (.not. engine%drifted(b)) call clear_edge(engine%grid%dim, pad_edge(engine%grid%dim, engine%basis), pad(:, :, first + b))
    end do
    words = transfer(pad, words)
    if (ranks > 1) call sum_words(words)
    pad = reshape(transfer(words, pad), shape(pad))
  end subroutine gather_pads

  subroutine clear_edge(d, edge, pad)
    integer, intent(in) :: d, edge(3)
    real(wp), intent(inout) :: pad(nf, 0:edge(1) - 1, 0:edge(2) - 1, 0:edge(3) - 1)
    pad(:, [0, edge(1) - 1], :, :) = 0.0_wp
    if (d > 1) pad(:, :, [0, edge(2) - 1], :) = 0.0_wp
    if (d > 2) pad(:, :, :, [0, edge(3) - 1]) = 0.0_wp
  end subroutine clear_edge

  !> Sum of all pads at the nodes of a slot, blocks around it in their order
  subroutine add_all(engine, code, pad, slot_at, total)
    type(engine_t), intent(in) :: engine
    integer(i8), intent(in) :: code(:)
    real(wp), intent(in) :: pad(:, :, :)
    integer, intent(in) :: slot_at(3)
    real(wp), intent(out) :: total(nf, nodes_per_block)
    integer :: x, y, z, b, place, node(3), edge(3), off(3), step(3)
    total = 0.0_wp
    edge = pad_edge(engine%grid%dim, engine%basis)
    step = merge(1, 0, [1, 2, 3] <= engine%grid%dim)
    do z = -step(3), step(3)
      do y = -step(2), step(2)
        do x = -step(1), step(1)
          b = findloc(code, block_key(slot_at + [x, y, z]), dim=1)
          if (b == 0) cycle
          do place = 0, nodes_per_block - 1
            off = [modulo(place, engine%grid%edge(1)), modulo(place/engine%grid%edge(1), engine%grid%edge(2)), &
                   place/(engine%grid%edge(1)*engine%grid%edge(2))]
            node = off - [x, y, z]*engine%grid%edge + drift*step
            if (any(node < 0 .or. node >= edge)) cycle
            total(:, place + 1) = total(:, place + 1) + pad(:, 1 + node(1) + edge(1)*(node(2) + edge(2)*node(3)), b)
          end do
        end do
      end do
    end do
  end subroutine add_all

  !> A number for a slot near a block: of the first block around it, and which of that one's neighbours it is; 0 if no block is near
  pure integer function place_of_slot(code, key) result(place)
    integer(i8), intent(in) :: code(:), key
    integer :: b, off(3)
    place = 0
    do b = 1, size(code)
      off = block_at_key(key) - block_at_key(code(b))
      if (any(abs(off) > 1)) cycle
      place = 27*(b - 1) + 14 + off(1) + 3*off(2) + 9*off(3)
      return
    end do
  end function place_of_slot

  !> Whether such a number is that of a slot
  pure logical function is_slot(d, code, place)
    integer, intent(in) :: d, place
    integer(i8), intent(in) :: code(:)
    integer :: k, off(3)
    k = modulo(place - 1, 27)
    off = [modulo(k, 3), modulo(k/3, 3), k/9] - 1
    is_slot = all(off == 0 .or. [1, 2, 3] <= d)
    if (is_slot) is_slot = place_of_slot(code, block_key(block_at_key(code((place - 1)/27 + 1)) + off)) == place
  end function is_slot

end program test_borders
