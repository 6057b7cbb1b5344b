defmodule {{Module}}Test do
  use ExUnit.Case, async: true

  test "emits numbers that differ by more than the step" do
    {:ok, changes} =
      Situ.Test.run([in: [{0, 1}, {1, 2}, {2, 8}, {3, 9}]], fn streams ->
        Situ.via(streams.in, {{Module}}, step: 2)
      end)

    assert changes == [{0, 1}, {2, 8}]
  end
end
