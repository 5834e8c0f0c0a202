!> Bodies become particles: counts, volumes, order, owners, free faces, polar sectors, refusals
program test_fill
  use gimp_kinds, only: wp, pi
  use gimp_error, only: error_t, report_lines
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_shapes, only: shape_t, shape_box, shape_sphere, shape_cylinder, shape_ring, shape_polygon
  use gimp_fill, only: fill_t, fill_body_t, fill_bodies, face_x_low, face_x_high, face_y_low, face_y_high, face_z_low, &
    face_z_high
  implicit none(type, external)
  real(wp), parameter :: zero(3) = 0.0_wp
  type(fill_t) :: r
  type(error_t), allocatable :: error

  call begin_suite("fill")
  call block_of_reference()
  call known_counts()
  call volumes_converge()
  call box_faces()
  call owners()
  call ring_symmetry()
  call polar_fill()
  call empty_space_is_free()
  call other_dimensions()
  call refusals()
  call end_suite()

contains

  !> A box body
  type(fill_body_t) function box(name, lower, upper, per_axis) result(body)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: lower(3), upper(3)
    integer, intent(in) :: per_axis
    body%name = name
    body%shape%kind = shape_box
    body%shape%lower = lower
    body%shape%upper = upper
    body%particles_per_axis = per_axis
  end function box

  !> A sphere, disk or segment
  type(fill_body_t) function ball(name, center, radius, per_axis) result(body)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: center(3), radius
    integer, intent(in) :: per_axis
    body%name = name
    body%shape%kind = shape_sphere
    body%shape%center = center
    body%shape%radius = radius
    body%particles_per_axis = per_axis
  end function ball

  !> The block of the golden runs: box of 6 cells of 0.25 from 0; 2 particles per axis; the first lines of the INIT table of
  !> d2_ugimp_usl_nh.txt and d3_linear_usl_nh.txt
  subroutine block_of_reference()
    call fill_bodies(2, zero, 0.25_wp, [6, 6, 1], [box("b", [0.25_wp, 0.25_wp, 0.0_wp], [0.75_wp, 0.75_wp, 0.0_wp], 2)], r, error)
    call check_true(.not. allocated(error), "block: is filled")
    call check(int(r%n), 16, "block: 2 x 2 cells with 4 particles")
    call check(r%position(:, 1), [0.3125_wp, 0.3125_wp], 0.0_wp, "block: first particle")
    call check(r%position(:, 2), [0.3125_wp, 0.4375_wp], 0.0_wp, "block: last axis fastest")
    call check(r%position(:, 3), [0.3125_wp, 0.5625_wp], 0.0_wp, "block: along the whole row, not cell by cell")
    call check(r%position(:, 5), [0.4375_wp, 0.3125_wp], 0.0_wp, "block: then the next row")
    call check(r%volume, spread(0.015625_wp, 1, 16), 0.0_wp, "block: volumes")
    call check(r%half_length(:, 7), [0.0625_wp, 0.0625_wp], 0.0_wp, "block: half lengths")
    call fill_bodies(3, zero, 0.25_wp, [6, 6, 6], [box("b", spread(0.25_wp, 1, 3), spread(0.75_wp, 1, 3), 2)], r, error)
    call check(int(r%n), 64, "block in 3D")
    call check(r%position(:, 6), [0.3125_wp, 0.4375_wp, 0.4375_wp], 0.0_wp, "block in 3D: order")
  end subroutine block_of_reference

  !> Counts found by an independent count of lattice points (a plain double loop over all cells, with exact integers)
  subroutine known_counts()
    integer :: i, j, expected
    expected = 0
    do i = -21, 21, 2 ! quarter points in units of h/4 from the centre of the disk, R = 16 of them
      do j = -21, 21, 2
        if (i*i + j*j <= 256) expected = expected + 1
      end do
    end do
    call fill_bodies(2, zero, 0.05_wp, [20, 20, 1], [ball("left", [0.2_wp, 0.2_wp, 0.0_wp], 0.2_wp, 2), &
      ball("right", [0.8_wp, 0.8_wp, 0.0_wp], 0.2_wp, 2)], r, error)
    call check_true(.not. allocated(error), "two disks: are filled, although they touch the walls")
    call check(int(r%count(1)), expected, "two disks: particles of the first")
    call check(int(r%count(2)), expected, "two disks: particles of the second")
    call check(int(r%first(2)), expected + 1, "two disks: the second follows the first")
    call check_true(all(r%position(1, :expected) < 0.5_wp), "two disks: the left one comes first")
    ! kinetic energy of the published fill is 2.6 = 0.5 * 1000 * 0.02 * area of both
    call check(sum(r%volume)*10.0_wp, 2.6_wp, 1.0e-12_wp, "two disks: kinetic energy of the published fill")
  end subroutine known_counts

  !> Filled volume tends to the exact one; tolerance: an eighth of the layer of cells at the surface
  subroutine volumes_converge()
    type(fill_body_t) :: body
    integer :: n
    do n = 16, 64, 16
      call fill_bodies(2, [-1.0_wp, -1.0_wp, 0.0_wp], 2.0_wp/n, [n, n, 1], [ball("disk", [0.05_wp, 0.02_wp, 0.0_wp], &
        0.8_wp, 2)], r, error)
      call check(sum(r%volume), 0.64_wp*pi, 0.125_wp*2.0_wp*pi*0.8_wp/n, "disk: area")
    end do
    call fill_bodies(3, spread(-1.0_wp, 1, 3), 0.1_wp, [20, 20, 20], [ball("ball", spread(0.03_wp, 1, 3), 0.8_wp, 3)], r, error)
    call check(sum(r%volume), 4.0_wp/3.0_wp*pi*0.512_wp, 0.02_wp, "ball: volume")
    body = ball("cylinder", [0.0_wp, 0.0_wp, 0.0_wp], 0.7_wp, 2)
    body%shape%kind = shape_cylinder
    body%shape%axis = 2
    call fill_bodies(3, spread(-1.0_wp, 1, 3), 0.1_wp, [20, 20, 20], [body], r, error)
    call check_true(.not. allocated(error), "cylinder without ends: goes from wall to wall")
    call check(sum(r%volume), 0.49_wp*pi*2.0_wp, 0.05_wp, "cylinder without ends: volume")
    body = box("U", zero, zero, 4)
    body%shape%kind = shape_polygon
    body%shape%vertices = reshape([0.0_wp, 0.0_wp, 3.0_wp, 0.0_wp, 3.0_wp, 3.0_wp, 2.0_wp, 3.0_wp, 2.0_wp, 1.0_wp, 1.0_wp, &
      1.0_wp, 1.0_wp, 3.0_wp, 0.0_wp, 3.0_wp], [2, 8])
    call fill_bodies(2, zero, 0.5_wp, [6, 6, 1], [body], r, error)
    call check(sum(r%volume), 7.0_wp, 1.0e-12_wp, "U: exact area, its edges lie on cell faces")
    call check(count(btest(r%faces, face_y_high)), 3*8, "U: free tops of both legs and of the base")
    call check(count(btest(r%faces, face_x_low)), 24 + 16, "U: free left sides")
  end subroutine volumes_converge

  !> The free faces of a box add up to its surface
  subroutine box_faces()
    real(wp) :: area(0:5)
    integer :: side, axis
    type(fill_body_t) :: body
    body = box("b", [0.2_wp, 0.4_wp, 0.0_wp], [1.0_wp, 1.0_wp, 1.2_wp], 2)
    body%particles_per_axis = [1, 2, 3]
    call fill_bodies(3, zero, 0.2_wp, [6, 6, 6], [body], r, error)
    call check(int(r%n), 4*6*18, "box: particles of 1, 2, 3 per axis")
    do side = 0, 5
      axis = side/2 + 1
      area(side) = sum(r%volume/(2.0_wp*r%half_length(axis, :)), mask=btest(r%faces, side))
    end do
    call check(area, [0.72_wp, 0.72_wp, 0.96_wp, 0.96_wp, 0.48_wp, 0.48_wp], 1.0e-13_wp, "box: area of the six sides")
    call check_true(all(btest(r%faces, face_x_low) .eqv. r%position(1, :) < 0.4_wp), "box: x_low is at lower x")
    call check_true(all(btest(r%faces, face_y_high) .eqv. r%position(2, :) > 0.9_wp), "box: y_high is at upper y")
    call check_true(all(btest(r%faces, face_z_high) .eqv. r%position(3, :) > 1.15_wp), "box: z_high is at upper z, at the wall")
    call check(count(btest(r%faces, face_z_low)), 24, "box: z_low")
  end subroutine box_faces

  !> A later body takes what is left; subtract carves the bodies above it, and frees the room for those below
  subroutine owners()
    type(fill_body_t) :: first, second, hole, plug, elsewhere
    first = box("first", [0.0_wp, 0.0_wp, 0.0_wp], [2.0_wp, 1.0_wp, 0.0_wp], 2)
    second = box("second", [1.0_wp, 0.0_wp, 0.0_wp], [3.0_wp, 1.0_wp, 0.0_wp], 4)
    hole = box("hole", [1.5_wp, 0.5_wp, 0.0_wp], [2.5_wp, 1.0_wp, 0.0_wp], 1)
    hole%subtract = .true.
    plug = box("plug", [1.5_wp, 0.0_wp, 0.0_wp], [4.0_wp, 1.0_wp, 0.0_wp], 2)
    elsewhere%name = "file"
    call fill_bodies(2, zero, 0.5_wp, [8, 2, 1], [first, second], r, error)
    call check_counts([32, 64], "overlap: the first body keeps the points")
    call check(sum(r%volume), 3.0_wp, 1.0e-13_wp, "overlap: union")
    call fill_bodies(2, zero, 0.5_wp, [8, 2, 1], [first, second, hole], r, error)
    call check_counts([28, 48, 0], "subtract: takes from both bodies above")
    call check(sum(r%volume), 2.5_wp, 1.0e-13_wp, "subtract: difference")
    call check(count(btest(r%faces(:r%count(1)), face_x_high)), 4, "subtract: the faces of the hole are free, as is x_high")
    call fill_bodies(2, zero, 0.5_wp, [8, 2, 1], [first, hole, second], r, error)
    call check_counts([28, 0, 64 + 16], "subtract in between: the later body fills the hole")
    call fill_bodies(2, zero, 0.5_wp, [8, 2, 1], [elsewhere, first, second, hole, plug], r, error)
    call check_counts([0, 28, 48, 0, 16 + 8], "plug: fills the hole and the free end")
    call check(sum(r%volume), 4.0_wp, 1.0e-13_wp, "plug: everything is filled once")
  end subroutine owners

  !> The number of particles of every body
  subroutine check_counts(expected, what)
    integer, intent(in) :: expected(:)
    character(len=*), intent(in) :: what
    call check(real(r%count, wp), real(expected, wp), 0.0_wp, what)
  end subroutine check_counts

  !> A centred ring is its own mirror image, and a quarter turn of itself
  subroutine ring_symmetry()
    type(fill_body_t) :: ring
    integer :: n, p, q, hits
    real(wp) :: image(2)
    ring%name = "ring"
    ring%shape%kind = shape_ring
    ring%shape%inner_radius = 0.4_wp
    ring%shape%outer_radius = 0.6_wp
    n = 16
    call fill_bodies(2, [-0.75_wp, -0.75_wp, 0.0_wp], 1.0_wp/n, [24, 24, 1], [ring], r, error)
    call check_true(.not. allocated(error), "ring: is filled")
    hits = 0
    do p = 1, int(r%n)
      image = [-r%position(2, p), r%position(1, p)]
      do q = 1, int(r%n)
        if (all(abs(r%position(:, q) - image) < 1.0e-12_wp)) hits = hits + 1
      end do
    end do
    call check(hits, int(r%n), "ring: each particle has its image by a quarter turn")
    call check(sum(r%volume), 0.2_wp*pi, 0.02_wp, "ring: area")
    call check(count(btest(r%faces, face_x_low)), count(btest(r%faces, face_x_high)), "ring: faces left and right")
    call check(count(btest(r%faces, face_x_low)), count(btest(r%faces, face_y_low)), "ring: faces left and below")
  end subroutine ring_symmetry

  !> Polar sectors: exact area, equal angles, mid radii
  subroutine polar_fill()
    type(fill_body_t) :: ring
    ring%name = "ring"
    ring%shape = shape_t(kind=shape_ring, center=[2.0_wp, 1.5_wp, 0.0_wp], inner_radius=0.75_wp, outer_radius=1.25_wp)
    ring%polar = .true.
    ring%radial_particles = 5
    ring%angular_particles = 36
    call fill_bodies(2, zero, 0.25_wp, [16, 16, 1], [ring], r, error)
    call check(int(r%n), 180, "polar: radial times angular particles")
    call check(sum(r%volume), pi, 1.0e-14_wp*180, "polar: exact area")
    call check(sum(r%volume(:36)), pi*(0.85_wp**2 - 0.75_wp**2), 1.0e-14_wp, "polar: exact area of the inner ring")
    call check(norm2(r%position(:, 1) - [2.0_wp, 1.5_wp]), 0.8_wp, 1.0e-15_wp, "polar: mid radius")
    call check(norm2(r%position(:, 180) - [2.0_wp, 1.5_wp]), 1.2_wp, 1.0e-15_wp, "polar: outermost mid radius")
    call check([sum(r%volume*r%position(1, :)), sum(r%volume*r%position(2, :))]/pi, [2.0_wp, 1.5_wp], 1.0e-14_wp, &
      "polar: centroid")
    call check(4.0_wp*r%half_length(1, :)*r%half_length(2, :), r%volume, 1.0e-16_wp, "polar: boxes of equal area")
    call check(sum(r%faces), 0, "polar: no lattice faces")
    ring%shape = shape_t(kind=shape_sphere, center=[2.0_wp, 1.5_wp, 0.0_wp], radius=0.5_wp)
    call fill_bodies(2, zero, 0.25_wp, [16, 16, 1], [ring], r, error)
    call check(sum(r%volume), 0.25_wp*pi, 1.0e-14_wp*180, "polar disk: exact area")
    ring%shape%cuts = 1
    ring%shape%cut_point(:2, 1) = [2.0_wp, 1.5_wp]
    ring%shape%cut_normal(:2, 1) = [0.0_wp, 1.0_wp]
    call fill_bodies(2, zero, 0.25_wp, [16, 16, 1], [ring], r, error)
    call check(sum(r%volume), 0.125_wp*pi, 1.0e-14_wp*180, "polar half disk: exact area")
    ring%shape%center(1) = 0.3_wp
    call fill_bodies(2, zero, 0.25_wp, [16, 16, 1], [ring], r, error)
    call check_true(index(error%message, "reaches beyond the grid box at x_low;") > 0, "polar: out of the grid box")
  end subroutine polar_fill

  !> Only the neighbourhood of a body is visited: this box has 1e18 lattice points, so that the test would not end otherwise
  subroutine empty_space_is_free()
    integer, parameter :: cells = 500000 ! 2 points each
    call fill_bodies(3, spread(0.0_wp, 1, 3), 0.01_wp, [cells, cells, cells], [ball("speck", spread(2500.0_wp, 1, 3), &
      0.05_wp, 2)], r, error)
    call check_true(.not. allocated(error), "speck in a huge box: is filled")
    call check(sum(r%volume), 4.0_wp/3.0_wp*pi*0.05_wp**3, 0.05_wp*0.05_wp**3, "speck in a huge box: volume")
  end subroutine empty_space_is_free

  !> One dimension; boxes that fill the grid box to its walls, at cell sizes that are no binary fractions
  subroutine other_dimensions()
    integer :: n
    call fill_bodies(1, [-1.0_wp, 0.0_wp, 0.0_wp], 0.125_wp, [16, 1, 1], [box("bar", [0.0_wp, 0.0_wp, 0.0_wp], &
      [0.5_wp, 0.0_wp, 0.0_wp], 2)], r, error)
    call check(int(r%n), 8, "bar: particles")
    call check(r%position(1, :), [0.03125_wp, 0.09375_wp, 0.15625_wp, 0.21875_wp, 0.28125_wp, 0.34375_wp, 0.40625_wp, &
      0.46875_wp], 0.0_wp, "bar: positions")
    call check(real(r%faces, wp), [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 2.0_wp], 0.0_wp, &
      "bar: x_low on the first, x_high on the last, nothing across")
    do n = 3, 60
      call fill_bodies(2, [0.1_wp, -0.7_wp, 0.0_wp], 1.0_wp/n, [n, n, 1], [box("full", [0.1_wp, -0.7_wp, 0.0_wp], &
        [1.1_wp, 0.3_wp, 0.0_wp], 3)], r, error)
      call check_true(.not. allocated(error), "box from wall to wall: does not stick out")
      call check(int(r%n), 9*n*n, "box from wall to wall: every point")
    end do
  end subroutine other_dimensions

  subroutine refusals()
    type(fill_body_t) :: inner
    call fill_bodies(2, zero, 0.5_wp, [8, 8, 1], [box("b", zero, [1.0_wp, 1.0_wp, 0.0_wp], 2), &
      ball("left", [2.0_wp, 2.0_wp, 0.0_wp], 0.01_wp, 2)], r, error)
    call check_true(index(error%message, "&body 2 'left': no particle centre lies inside;") == 1, "body between the points")
    inner = ball("inner", [0.5_wp, 0.5_wp, 0.0_wp], 0.4_wp, 2)
    call fill_bodies(2, zero, 0.5_wp, [8, 8, 1], [box("b", zero, [1.0_wp, 1.0_wp, 0.0_wp], 2), inner], r, error)
    call check_true(allocated(error), "body inside another one has no particles")
    call fill_bodies(2, zero, 0.5_wp, [8, 8, 1], [box("far", spread(5.0_wp, 1, 3), spread(6.0_wp, 1, 3), 2), &
      box("off", [3.0_wp, -1.0_wp, 0.0_wp], [5.0_wp, 1.0_wp, 0.0_wp], 2)], r, error)
    call check(report_lines(error), 2, "both bodies are named")
    call check_true(index(error%message, "&body 1 'far': lies outside the grid box") == 1, "body off the grid box")
    call check_true(index(error%message, "&body 2 'off': reaches beyond the grid box at x_high y_low;") > 0, &
      "body across two walls")
    inner%polar = .true.
    inner%shape%kind = shape_box
    call fill_bodies(2, zero, 0.5_wp, [8, 8, 1], [inner], r, error)
    call check(report_lines(error), 3, "polar box without size and without particles: three messages")
    ! a disk across a wall, cut at the wall, is a half model and no mistake
    inner = ball("half", [0.0_wp, 2.0_wp, 0.0_wp], 1.0_wp, 2)
    inner%shape%cuts = 1
    inner%shape%cut_normal(1, 1) = -1.0_wp
    call fill_bodies(2, zero, 0.1_wp, [40, 40, 1], [inner], r, error)
    call check_true(.not. allocated(error), "half disk cut at the wall")
    call check(sum(r%volume), 0.5_wp*pi, 0.02_wp, "half disk: area")
  end subroutine refusals

end program test_fill
