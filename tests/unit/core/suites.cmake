gimp_add_unit_test(core test_tensor)
