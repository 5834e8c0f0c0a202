!> The sort: every particle once, in the order of block, material, cell and number, whatever the order they came in
program test_sort
  use gimp_kinds, only: wp, i8, lanes
  use gimp_basis, only: basis_linear, basis_ugimp, basis_cpgimp
  use gimp_engine, only: engine_t, pass_t, pad_bytes, grid_bytes
  use gimp_resort, only: sort_particles
  use gimp_particle_pass, only: particle_pass
  use gimp_images, only: fold_images
  use gimp_engine_fixture, only: cloud_t, random_cloud, make_engine, read_cloud, node_sums, random_reals
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use omp_lib, only: omp_set_num_threads, omp_get_max_threads
  implicit none(type, external)

  integer :: seed = 99, dim, basis

  call begin_suite("sort")
  do dim = 1, 3
    do basis = basis_linear, basis_cpgimp
      call test_order(dim, basis)
    end do
    call test_history(dim)
    call test_periodic(dim)
  end do
  call test_removal()
  do dim = 1, 3
    call test_threads(dim)
  end do
  call test_crowd()
  call test_counts()
  call end_suite()

contains

  subroutine some_cloud(dim, cloud)
    integer, intent(in) :: dim
    type(cloud_t), intent(out) :: cloud
    real(wp) :: high(3)
    high = 0.0_wp
    high(:dim) = merge(200.0_wp, merge(30.0_wp, 11.0_wp, dim == 2), dim == 1)
    call random_cloud(dim, 700, [0.0_wp, 0.0_wp, 0.0_wp], high, 0.1_wp, 0.9_wp, seed, cloud)
    cloud%material(::4) = 3
    cloud%material(2::4) = 2
    cloud%x(:dim, 10) = 8.0_wp ! a corner of blocks
    cloud%x(:dim, 11) = 0.0_wp
  end subroutine some_cloud

  function box(dim) result(cells)
    integer, intent(in) :: dim
    integer :: cells(3)
    cells = 1
    cells(:dim) = merge(200, merge(30, 11, dim == 2), dim == 1)
  end function box

  subroutine test_order(dim, basis)
    integer, intent(in) :: dim, basis
    type(engine_t) :: engine
    type(cloud_t) :: cloud, after
    integer :: g, c, l, k, wrong(6), last_cell, cell, base
    integer(i8) :: last_id
    real(wp) :: half
    character(len=:), allocatable :: which
    which = ", "//text_of(dim)//"D, basis "//text_of(basis)
    call some_cloud(dim, cloud)
    call make_engine(dim, basis, box(dim), 1.0_wp, cloud, engine, with_force=.true., with_faces=.true.)
    call sort_particles(engine)
    wrong = 0
    associate (p => engine%particles)
      call check(int(p%n), cloud%n, "every particle is there"//which)
      do g = 1, size(p%groups)
        if (g > 1) then
          if (p%groups(g)%first /= p%groups(g - 1)%last + 1) wrong(1) = wrong(1) + 1
          if (p%groups(g)%block < p%groups(g - 1)%block) wrong(1) = wrong(1) + 1
          if (p%groups(g)%block == p%groups(g - 1)%block .and. p%groups(g)%material <= p%groups(g - 1)%material) &
            wrong(1) = wrong(1) + 1
        end if
        if (any(p%groups(g)%at /= engine%table%block_at(:, p%groups(g)%block))) wrong(2) = wrong(2) + 1
        if (g < p%block_group(p%groups(g)%block) .or. g >= p%block_group(p%groups(g)%block + 1)) wrong(2) = wrong(2) + 1
        last_cell = -1
        last_id = 0
        do c = p%groups(g)%first, p%groups(g)%last
          do l = 1, lanes
            if (p%id(l, c) == 0) then
              if (c < p%groups(g)%last .or. l == 1) wrong(3) = wrong(3) + 1
              if (p%p(l, p%mass%first, c) /= 0.0_wp .or. p%p(l, p%volume%first, c) /= 0.0_wp) wrong(3) = wrong(3) + 1
              if (any(p%p(l, p%force%first:p%force%first + dim - 1, c) /= 0.0_wp)) wrong(3) = wrong(3) + 1
              if (any(p%p(l, :dim, c) /= p%p(1, :dim, c))) wrong(3) = wrong(3) + 1
              cycle
            end if
            if (l > 1) then
              if (p%id(l - 1, c) == 0) wrong(3) = wrong(3) + 1
            end if
            cell = 0
            do k = dim, 1, -1
              half = 0.0_wp
              if (basis /= basis_linear) half = min(0.5_wp, cloud%half(k, int(p%id(l, c))))
              base = floor(p%p(l, k, c) - half)
              if (base < 0 .or. base >= engine%grid%edge(k)) wrong(4) = wrong(4) + 1
              cell = base + engine%grid%edge(k)*cell
            end do
            if (cell < last_cell .or. (cell == last_cell .and. p%id(l, c) <= last_id)) wrong(5) = wrong(5) + 1
            last_cell = cell
            last_id = p%id(l, c)
            if (cloud%material(int(last_id)) /= p%groups(g)%material) wrong(6) = wrong(6) + 1
          end do
        end do
      end do
    end associate
    call check(wrong(1), 0, "groups follow each other by block and material"//which)
    call check(wrong(2), 0, "groups know their block and blocks their groups"//which)
    call check(wrong(3), 0, "spare lanes are at the end of a group, massless twins of the first lane"//which)
    call check(wrong(4), 0, "supports start in their block"//which)
    call check(wrong(5), 0, "particles ascend by cell, then by number"//which)
    call check(wrong(6), 0, "materials stay apart"//which)
    call read_cloud(engine, after)
    call check_true(all(after%id > 0), "every number once"//which)
    call check(maxval(abs(after%x - cloud%x)), 0.0_wp, 4*epsilon(1.0_wp)*200, "positions are where they were"//which)
    call check_true(all(after%v == cloud%v) .and. all(after%f == cloud%f) .and. all(after%mass == cloud%mass), &
                    "all else came along bit by bit"//which)
  end subroutine test_order

  !> The same particles in another order, or sorted twice, end in the same bits
  subroutine test_history(dim)
    integer, intent(in) :: dim
    type(engine_t) :: one, other
    type(cloud_t) :: cloud, shuffled
    real(wp) :: u(1)
    integer :: i, j
    call some_cloud(dim, cloud)
    call make_engine(dim, basis_ugimp, box(dim), 1.0_wp, cloud, one)
    shuffled = cloud
    do i = cloud%n, 2, -1
      call random_reals(seed, u)
      j = 1 + int(0.5_wp*(u(1) + 1.0_wp)*i)
      call swap(shuffled, i, min(j, i))
    end do
    call check_true(any(shuffled%id /= cloud%id), "the order did change")
    call make_engine(dim, basis_ugimp, box(dim), 1.0_wp, shuffled, other)
    call sort_particles(one)
    call sort_particles(other)
    call check_true(all(one%particles%id == other%particles%id) .and. all(one%particles%p == other%particles%p), &
                    "the order of particles before the sort leaves no trace, "//text_of(dim)//"D")
    call sort_particles(other)
    call check_true(all(one%particles%id == other%particles%id) .and. all(one%particles%p == other%particles%p), &
                    "a second sort changes nothing, "//text_of(dim)//"D")
  end subroutine test_history

  subroutine swap(cloud, i, j)
    type(cloud_t), intent(inout) :: cloud
    integer, intent(in) :: i, j
    cloud%x(:, [i, j]) = cloud%x(:, [j, i])
    cloud%v(:, [i, j]) = cloud%v(:, [j, i])
    cloud%f(:, [i, j]) = cloud%f(:, [j, i])
    cloud%half(:, [i, j]) = cloud%half(:, [j, i])
    cloud%half0(:, [i, j]) = cloud%half0(:, [j, i])
    cloud%mass([i, j]) = cloud%mass([j, i])
    cloud%volume([i, j]) = cloud%volume([j, i])
    cloud%material([i, j]) = cloud%material([j, i])
    cloud%id([i, j]) = cloud%id([j, i])
  end subroutine swap

  !> A periodic axis whose cells are no multiple of a block's edge: particles that left return on the other side, and nodes
  !> keep all mass and momentum after folding; a cloud shifted once around gives the same nodes
  subroutine test_periodic(dim)
    integer, intent(in) :: dim
    type(engine_t) :: engine, around
    type(cloud_t) :: cloud, after, moved
    real(wp), allocatable :: raw(:, :, :), raw2(:, :, :)
    real(wp) :: total
    integer :: cells(3), k
    call some_cloud(dim, cloud)
    cloud%half = 0.25_wp
    cloud%half0 = 0.25_wp
    cells = box(dim)
    cells(1) = cells(1) - 1
    moved = cloud
    moved%x(1, ::2) = moved%x(1, ::2) + cells(1)
    moved%x(1, 1::4) = moved%x(1, 1::4) - 2*cells(1)
    call make_engine(dim, basis_ugimp, cells, 1.0_wp, cloud, engine)
    call make_engine(dim, basis_ugimp, cells, 1.0_wp, moved, around)
    engine%grid%periodic(1) = .true.
    around%grid%periodic(1) = .true.
    call sort_particles(engine)
    call sort_particles(around)
    call read_cloud(around, after)
    call check_true(all(after%x(1, :) >= 0.0_wp) .and. all(after%x(1, :) <= cells(1)), "positions wrap, "//text_of(dim)//"D")
    call check(maxval(abs(modulo(after%x(1, :) - cloud%x(1, :) + 0.5_wp, real(cells(1), wp)) - 0.5_wp)), 0.0_wp, 1.0e-12_wp, &
               "by whole turns, "//text_of(dim)//"D")
    call particle_pass(engine, pass_t(momentum=.true., force=.true.))
    call particle_pass(around, pass_t(momentum=.true., force=.true.))
    call node_sums(engine, raw)
    call node_sums(around, raw2)
    call check_true(size(engine%images) > 0, "there are images")
    call fold_images(engine%images, engine%table%slots, raw)
    call fold_images(around%images, around%table%slots, raw2)
    do k = 1, 4
      total = sum(cloud%mass)
      if (k <= dim) total = sum(cloud%mass*cloud%v(k, :))
      if (k <= dim .or. k == 4) call check(sum(raw(k, :, :)), total, 1.0e-12_wp*sum(cloud%mass), &
                                          "mass and momentum after folding, "//text_of(dim)//"D")
    end do
    do k = 1, dim
      call check(sum(raw(4 + k, :, :)), 0.0_wp, 1.0e-13_wp*sum(abs(raw(4 + k, :, :))), "forces after folding")
    end do
    if (size(raw) == size(raw2)) then
      call check(maxval(abs(raw - raw2)), 0.0_wp, 1.0e-12_wp*maxval(abs(raw)), "a turn around the box changes no node")
    else
      call check_true(.false., "a turn around the box changes no block")
    end if
  end subroutine test_periodic

  !> Marked particles are dropped, the others stay; blocks that are left empty go too
  subroutine test_removal()
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    logical, allocatable :: remove(:, :)
    integer :: c, l, blocks, kept
    call some_cloud(2, cloud)
    call make_engine(2, basis_ugimp, box(2), 1.0_wp, cloud, engine)
    call sort_particles(engine)
    blocks = engine%table%blocks
    allocate (remove(lanes, engine%particles%chunks), source=.false.)
    do c = 1, engine%particles%chunks
      do l = 1, lanes
        if (engine%particles%id(l, c) > 0) remove(l, c) = cloud%x(1, int(engine%particles%id(l, c))) > 10.0_wp
      end do
    end do
    kept = count(cloud%x(1, :) <= 10.0_wp)
    call sort_particles(engine, remove)
    call check(int(engine%particles%n), kept, "those not marked are kept")
    call check(count(engine%particles%id > 0), kept, "and have their numbers")
    call check_true(engine%table%blocks < blocks, "empty blocks are gone")
    call check_true(size(engine%pad, 3) == engine%table%blocks .and. size(engine%g, 3) == engine%table%slots, &
                    "grid and pads fit the blocks")
    allocate (remove(lanes, engine%particles%chunks), source=.true.)
    call sort_particles(engine, remove)
    call check(int(engine%particles%n), 0, "all can go")
    call check(engine%table%blocks, 0, "and leave no block")
    call particle_pass(engine, pass_t(momentum=.true.))
  end subroutine test_removal

  !> Any number of threads sorts the same, far moves (the first sort) and near ones, with more and with fewer chunks than before
  subroutine test_threads(dim)
    integer, intent(in) :: dim
    integer, parameter :: threads(4) = [1, 2, 3, 8]
    type(engine_t) :: engine(size(threads))
    type(cloud_t) :: cloud
    real(wp) :: high(3), u(3)
    integer :: t, c, l, k, round, mark, usual
    usual = omp_get_max_threads()
    high = 0.0_wp
    high(:dim) = box(dim)
    call random_cloud(dim, 6000, [0.0_wp, 0.0_wp, 0.0_wp], 0.7_wp*high, 0.1_wp, 0.4_wp, seed, cloud)
    cloud%material(::5) = 2
    mark = seed
    do t = 1, size(threads)
      call omp_set_num_threads(threads(t))
      call make_engine(dim, basis_ugimp, box(dim), 1.0_wp, cloud, engine(t))
      call sort_particles(engine(t))
      do round = 1, 3
        seed = mark
        do c = 1, engine(t)%particles%chunks
          do l = 1, lanes
            call random_reals(seed, u)
            do k = 1, dim
              engine(t)%particles%p(l, k, c) = engine(t)%particles%p(l, k, c) + 0.3_wp*u(k) + merge(0.5_wp, -0.5_wp, round < 3)
            end do
          end do
        end do
        call sort_particles(engine(t))
      end do
      call check(count(engine(t)%particles%id > 0), cloud%n, "every particle is there, "//text_of(threads(t))//" threads")
      call check_true(all(shape(engine(t)%particles%p) == shape(engine(1)%particles%p)), "as many chunks")
      call check_true(all(engine(t)%particles%id == engine(1)%particles%id) .and. all(engine(t)%particles%p == engine(1)%particles%p) &
                      .and. all(engine(t)%table%slot_at == engine(1)%table%slot_at) &
                      .and. all(engine(t)%table%slot_near == engine(1)%table%slot_near), &
                      "the same bits, "//text_of(dim)//"D, "//text_of(threads(t))//" threads")
    end do
    call omp_set_num_threads(usual)
  end subroutine test_threads

  !> Hundreds of particles in a cell, in falling order of their numbers
  subroutine test_crowd()
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    integer :: i, c, l, wrong
    integer(i8) :: last
    call random_cloud(2, 900, [0.0_wp, 0.0_wp, 0.0_wp], [1.0_wp, 1.0_wp, 0.0_wp], 0.0_wp, 0.0_wp, seed, cloud)
    cloud%id = [(int(cloud%n + 1 - i, i8), i=1, cloud%n)]
    call make_engine(2, basis_linear, box(2), 1.0_wp, cloud, engine)
    call sort_particles(engine)
    wrong = 0
    last = 0
    do c = 1, engine%particles%chunks
      do l = 1, lanes
        if (engine%particles%id(l, c) == 0) cycle
        if (engine%particles%id(l, c) /= last + 1) wrong = wrong + 1
        last = engine%particles%id(l, c)
      end do
    end do
    call check(wrong, 0, "a crowded cell ascends by number")
    call check(int(last), cloud%n, "and is complete")
  end subroutine test_crowd

  !> Sizes for 1e9 and 1e10 particles, one in a cell, without the memory
  subroutine test_counts()
    integer, parameter :: blocks = 160000000
    call check_true(pad_bytes(3, basis_ugimp, blocks) == 8_i8*storage_size(1.0_wp)/8*512*blocks, "bytes of pads")
    call check_true(grid_bytes(blocks) == 8_i8*storage_size(1.0_wp)/8*64*blocks, "bytes of the grid")
  end subroutine test_counts

end program test_sort
