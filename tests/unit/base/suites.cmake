gimp_add_unit_test(base test_hash_sorting)
gimp_add_unit_test(base test_exact_sum)
gimp_add_unit_test(base test_parcel)
gimp_add_unit_test(base test_shares)
