!> What the sides of the box do to the velocity of a node on them, beyond them, and where they meet
program test_walls
  use gimp_kinds, only: wp
  use gimp_grid, only: grid_t, make_grid, has_images
  use gimp_walls, only: walls_t, side_free, side_stick, side_slip, side_symmetry, side_periodic, side_velocity, set_walls, &
    walls_near, constrain, move_walls, side_of_word, condition_of_word, is_wall
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: v(3) = [1.0_wp, -2.0_wp, 3.0_wp]
  type(grid_t) :: grid

  call begin_suite("walls")
  grid = make_grid(3, [0.0_wp, 0.0_wp, 0.0_wp], [10.0_wp, 10.0_wp, 10.0_wp], 1.0_wp)
  call test_words()
  call test_one_side()
  call test_corners()
  call test_open_knots()
  call test_moving()
  call test_near()
  call test_images()
  call end_suite()

contains

  subroutine test_words()
    integer :: axis, end
    call side_of_word("x_low", axis, end)
    call check_true(axis == 1 .and. end == 1, "x_low")
    call side_of_word("z_high", axis, end)
    call check_true(axis == 3 .and. end == 2, "z_high")
    call side_of_word("all", axis, end)
    call check(axis, 0, "all is no single side")
    call side_of_word("w_low", axis, end)
    call check(axis, 0, "there is no axis w")
    call check(condition_of_word("symmetry"), side_symmetry, "word of a condition")
    call check(condition_of_word("velocity"), side_velocity, "word of another")
    call check(condition_of_word("sticky"), -1, "an unknown condition")
  end subroutine test_words

  !> The velocity that is left at a node
  function held(walls, node) result(w)
    type(walls_t), intent(in) :: walls
    integer, intent(in) :: node(3)
    real(wp) :: w(3)
    w = v
    call constrain(walls, grid, node, w)
  end function held

  subroutine test_one_side()
    type(walls_t) :: walls
    call check(held(walls, [0, 0, 0]), v, 0.0_wp, "free sides hold nothing")
    walls%side(2, 2)%condition = side_slip
    call check(held(walls, [5, 10, 5]), [v(1), 0.0_wp, v(3)], 0.0_wp, "slip holds the normal component")
    call check(held(walls, [5, 12, 5]), [v(1), 0.0_wp, v(3)], 0.0_wp, "also of ghosts beyond")
    call check(held(walls, [5, 9, 5]), v, 0.0_wp, "but not inside")
    call check(held(walls, [5, 0, 5]), v, 0.0_wp, "nor on the other side")
    walls%side(2, 2)%condition = side_symmetry
    call check(held(walls, [5, 10, 5]), [v(1), 0.0_wp, v(3)], 0.0_wp, "symmetry holds the normal component")
    walls%side(2, 2)%condition = side_stick
    call check(held(walls, [5, 10, 5]), [0.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "stick holds all")
    call check(held(walls, [-2, 12, 5]), [0.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "in corners with free sides too")
    walls%side(2, 2)%condition = side_periodic
    call check(held(walls, [5, 10, 5]), v, 0.0_wp, "periodic sides hold nothing")
  end subroutine test_one_side

  !> Open-knot splines: 10 cells have functions -1 ... 10 (quadratic) or 11 (cubic), and the side holds the end ones alone
  subroutine test_open_knots()
    type(walls_t) :: walls
    type(grid_t) :: open
    real(wp) :: w(3)
    integer :: degree, node
    walls%side(:, 1)%condition = side_stick
    open = grid
    do degree = 2, 3
      open%open_degree = degree
      do node = -1, 8 + degree
        w = v
        call constrain(walls, open, [node, 5, 5], w)
        call check_true(all(w == 0.0_wp) .eqv. (node == -1 .or. node == 8 + degree), "only end functions are held")
      end do
      call check_true(walls_near(walls, open, [-1, 0, 0]) .and. .not. walls_near(walls, open, [0, 0, 0]), "the block that holds them")
      call check_true(walls_near(walls, open, [2, 0, 0]) .and. .not. walls_near(walls, open, [1, 0, 0]), "above too")
    end do
  end subroutine test_open_knots

  !> Where sides meet, both are obeyed, and what holds more wins whichever axis it is on
  subroutine test_corners()
    type(walls_t) :: walls
    walls%side(1, 1)%condition = side_slip
    walls%side(1, 2)%condition = side_slip
    call check(held(walls, [0, 0, 5]), [0.0_wp, 0.0_wp, v(3)], 0.0_wp, "slip on both sides of an edge")
    walls%side(1, 3)%condition = side_slip
    call check(held(walls, [0, 0, 0]), [0.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "slip on the sides of a corner")
    walls%side(1, 2)%condition = side_velocity
    walls%side(1, 2)%now = [4.0_wp, 5.0_wp, 6.0_wp]
    call check(held(walls, [0, 0, 0]), [4.0_wp, 5.0_wp, 6.0_wp], 0.0_wp, "a driven side carries the nodes of its edges")
    walls%side(1, 2)%condition = side_slip
    walls%side(1, 1)%condition = side_stick
    call check(held(walls, [0, 0, 4]), [0.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "stick wins over slip on a later axis")
    walls%side(1, 1)%condition = side_slip
    walls%side(1, 2)%condition = side_stick
    call check(held(walls, [0, 0, 4]), [0.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "and on an earlier one")
  end subroutine test_corners

  subroutine test_moving()
    type(walls_t) :: walls
    walls%side(1, 1)%condition = side_velocity
    walls%side(1, 1)%velocity = [2.0_wp, 0.0_wp, -1.0_wp]
    walls%side(1, 1)%table%times = [0.0_wp, 1.0_wp]
    walls%side(1, 1)%table%factors = [0.0_wp, 1.0_wp]
    walls%side(2, 1)%velocity = [9.0_wp, 9.0_wp, 9.0_wp] ! free: its velocity means nothing
    call move_walls(walls, 0.25_wp)
    call check(held(walls, [0, 5, 5]), [0.5_wp, 0.0_wp, -0.25_wp], 1.0e-15_wp, "a driven side follows its table")
    call check(walls%side(2, 1)%now, [0.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "a free side does not move")
    call move_walls(walls, 3.0_wp)
    call check(held(walls, [-1, 5, 5]), [2.0_wp, 0.0_wp, -1.0_wp], 1.0e-15_wp, "and keeps the last factor")
  end subroutine test_moving

  !> A block is near a wall exactly if constrain could touch one of its nodes (10 cells: blocks -1 and 0 below, 2 and 3 above)
  subroutine test_near()
    type(walls_t) :: walls
    integer :: at, node, k
    logical :: touched
    real(wp) :: w(3)
    do k = 1, 2
      walls = walls_t()
      walls%side(k, 1)%condition = side_slip
      do at = -2, 4
        touched = .false.
        do node = 4*at, 4*at + 3
          w = v
          call constrain(walls, grid, [node, 5, 5], w)
          touched = touched .or. w(1) == 0.0_wp
        end do
        call check_true(walls_near(walls, grid, [at, 1, 1]) .eqv. touched, "a block knows whether a side holds its nodes")
      end do
    end do
    walls%side(:, 1)%condition = side_free
    call check_true(.not. walls_near(walls, grid, [0, 0, 0]), "free sides hold no block")
    call check_true(.not. is_wall(walls%side(1, 1)), "a free side is no wall")
    walls%side(1, 1)%condition = side_periodic
    call check_true(.not. is_wall(walls%side(1, 1)), "a periodic side is no wall")
    walls%side(1, 1)%condition = side_symmetry
    call check_true(is_wall(walls%side(1, 1)), "a plane of symmetry is one")
  end subroutine test_near

  subroutine test_images()
    type(walls_t) :: walls
    type(grid_t) :: here
    here = grid
    call set_walls(walls, here)
    call check_true(.not. has_images(here), "free sides have no images")
    walls%side(:, 2)%condition = side_periodic
    walls%side(2, 3)%condition = side_symmetry
    call set_walls(walls, here)
    call check_true(all(here%periodic .eqv. [.false., .true., .false.]), "the grid knows its periodic axes")
    call check_true(here%mirror_high(3) .and. .not. here%mirror_low(3) .and. has_images(here), "and its mirrors")
  end subroutine test_images

end program test_walls
