!> The hash table keeps every key through growth and collisions; the radix sort is right and stable
program test_hash_sorting
  use gimp_common_kinds, only: i8
  use gimp_hash_table, only: hash_table_t, clear_table, insert_key, find_key, mix_bits
  use gimp_sorting, only: sort_order, rank_keys
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  call begin_suite("hash and sorting")
  call test_insert_and_find()
  call test_clear_forgets()
  call test_mix_bits()
  call test_sort_random()
  call test_sort_special()
  call end_suite()

contains

  !> Reproducible keys of all 64 bits, some negative
  pure elemental integer(i8) function scattered(k)
    integer, intent(in) :: k
    scattered = mix_bits(int(k, i8) + 977_i8)
  end function scattered

  !> 5000 keys into a table made for ten: it grows nine times, and none is lost or doubled
  subroutine test_insert_and_find()
    integer, parameter :: n = 5000
    type(hash_table_t) :: table
    integer :: k, value, wrong_new, wrong_old, wrong_found, wrong_missing
    call clear_table(table, 10)
    call check(find_key(table, 5_i8), 0, "an empty table has no key")
    wrong_new = 0
    wrong_old = 0
    do k = 1, n
      call insert_key(table, merge(scattered(k), int(k, i8), modulo(k, 2) == 0), k, value)
      if (value /= k) wrong_new = wrong_new + 1
    end do
    do k = n, 1, -1
      call insert_key(table, merge(scattered(k), int(k, i8), modulo(k, 2) == 0), n + 1, value)
      if (value /= k) wrong_old = wrong_old + 1
    end do
    wrong_found = 0
    wrong_missing = 0
    do k = 1, n
      if (find_key(table, merge(scattered(k), int(k, i8), modulo(k, 2) == 0)) /= k) wrong_found = wrong_found + 1
      if (find_key(table, scattered(k + n)) /= 0) wrong_missing = wrong_missing + 1
    end do
    call check(wrong_new, 0, "a new key gets the fresh value")
    call check(wrong_old, 0, "a known key keeps its value")
    call check(wrong_found, 0, "every key is found after growth")
    call check(wrong_missing, 0, "a key that was never inserted is not found")
    call check(table%n, n, "the table counts its keys")
  end subroutine test_insert_and_find

  subroutine test_clear_forgets()
    type(hash_table_t) :: table
    integer :: k, value, left
    call clear_table(table, 100)
    do k = 1, 100
      call insert_key(table, int(k, i8), k, value)
    end do
    call clear_table(table, 20)
    left = 0
    do k = 1, 100
      if (find_key(table, int(k, i8)) /= 0) left = left + 1
    end do
    call check(left, 0, "a cleared table has forgotten its keys")
    call insert_key(table, 0_i8, 7, value)
    call check(find_key(table, 0_i8), 7, "key 0 is a key like any other")
  end subroutine test_clear_forgets

  !> The published numbers of splitmix64 with seed 0: its state advances by 9E3779B97F4A7C15 before each finaliser
  subroutine test_mix_bits()
    integer(i8), parameter :: golden = int(z"9E3779B97F4A7C15", i8)
    call check_true(mix_bits(golden) == int(z"E220A8397B1DCDAF", i8), "first number of splitmix64")
    call check_true(mix_bits(2*golden) == int(z"6E789E6AA1B965F4", i8), "second number of splitmix64")
    call check_true(mix_bits(3*golden) == int(z"06C45D188009454F", i8), "third number of splitmix64")
  end subroutine test_mix_bits

  !> Random non-negative keys with many repeats: ascending, a permutation, and equal keys in the order they came
  subroutine test_sort_random()
    integer, parameter :: n = 3000
    integer(i8) :: key(n)
    integer, allocatable :: order(:)
    integer :: k, down, unstable
    logical :: seen(n)
    do k = 1, n
      key(k) = iand(scattered(k), int(z"7F0000FF00000003", i8))
      if (modulo(k, 3) == 0) key(k) = modulo(k, 50)
    end do
    call sort_order(key, order)
    seen = .false.
    seen(order) = .true.
    down = 0
    unstable = 0
    do k = 2, n
      if (key(order(k)) < key(order(k - 1))) down = down + 1
      if (key(order(k)) == key(order(k - 1)) .and. order(k) < order(k - 1)) unstable = unstable + 1
    end do
    call check_true(all(seen), "the order is a permutation")
    call check(down, 0, "keys ascend")
    call check(unstable, 0, "equal keys keep their order")
  end subroutine test_sort_random

  subroutine test_sort_special()
    integer, allocatable :: order(:)
    integer(i8), allocatable :: distinct(:)
    integer(i8) :: none(0)
    call sort_order(none, order)
    call check(size(order), 0, "nothing to sort")
    call sort_order([42_i8], order)
    call check(order(1), 1, "one key")
    call sort_order([7_i8, 7_i8, 7_i8], order)
    call check_true(all(order == [1, 2, 3]), "equal keys stay")
    call sort_order([2_i8**62, 256_i8, 255_i8, 2_i8**32], order)
    call check_true(all(order == [3, 2, 4, 1]), "bytes far apart")
    call rank_keys([9_i8, 4_i8, 9_i8, 2_i8**40, 4_i8], distinct, order)
    call check_true(all(distinct == [4_i8, 9_i8, 2_i8**40]), "each key once, ascending")
    call check_true(all(order == [2, 1, 2, 3, 1]), "and where every key stands among them")
    call rank_keys(none, distinct, order)
    call check(size(distinct) + size(order), 0, "nothing to rank")
  end subroutine test_sort_special

end program test_hash_sorting
