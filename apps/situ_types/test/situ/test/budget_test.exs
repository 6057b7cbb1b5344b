defmodule Situ.Test.BudgetTest do
  # The environment is the whole system's.
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

  test "the environment sets how many damaged inputs are tried" do
    System.delete_env("SITU_MUTATIONS")
    assert Budget.mutations(500) == 500
    System.put_env("SITU_MUTATIONS", "7")
    assert Budget.mutations(500) == 7
    System.put_env("SITU_MUTATIONS", "many")
    assert_raise ArgumentError, fn -> Budget.mutations(500) end
  end
end
