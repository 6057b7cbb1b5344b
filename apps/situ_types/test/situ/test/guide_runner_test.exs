defmodule Situ.Test.GuideRunnerTest do
  use ExUnit.Case, async: true
  alias Situ.Test.GuideRunner

  doctest GuideRunner

  @moduletag :tmp_dir

  defp guide(dir, text) do
    path = Path.join(dir, "guide.md")
    File.write!(path, text)
    path
  end

  test "blocks share variables and aliases, and return the values they show", %{tmp_dir: dir} do
    path =
      guide(dir, """
      ```elixir
      alias Situ.Time
      t = Time.ms(start)
      ```
      ```sh
      exit 1
      ```
      ```elixir
      {t, Time.ms(1)}
      # => {3_000_000,
      #     1_000_000}
      ```
      """)

    assert GuideRunner.run_blocks(path, bindings: [start: 3]) == 2
  end

  test "reports the line of a block that returns a different value", %{tmp_dir: dir} do
    path = guide(dir, "# One\n\n```elixir\n1 + 1\n# => 3\n```\n")
    error = assert_raise ExUnit.AssertionError, fn -> GuideRunner.run_blocks(path) end
    assert error.message == "guide.md:4: the result is 2\n1 + 1\n# => 3\n"
  end

  test "reports the line of a block that raises", %{tmp_dir: dir} do
    path = guide(dir, "```elixir\n:ok\nraise \"no\"\n```\n")
    error = assert_raise ExUnit.AssertionError, fn -> GuideRunner.run_blocks(path) end
    assert error.message =~ "guide.md:2: no\n"
  end
end
