defmodule Situ.Test.BudgetTest do
  # Not async, because the environment is global.
  use ExUnit.Case, async: false
  alias Situ.Test.Budget

  doctest Budget

  setup do
    before = System.get_env("SITU_MUTATIONS")

    on_exit(fn ->
      if before,
        do: System.put_env("SITU_MUTATIONS", before),
        else: System.delete_env("SITU_MUTATIONS")
    end)
  end

  test "the environment sets the number of damaged inputs" do
    System.delete_env("SITU_MUTATIONS")
    assert Budget.mutation_count(500) == 500
    System.put_env("SITU_MUTATIONS", "7")
    assert Budget.mutation_count(500) == 7
    System.put_env("SITU_MUTATIONS", "many")
    assert_raise ArgumentError, fn -> Budget.mutation_count(500) end
  end
end
