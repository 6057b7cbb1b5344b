defmodule Situ.ClusterGuideTest do
  # The Elixir blocks of the guide run, one after the other; a block that ends in `# => value` gives that value.
  use ExUnit.Case, async: false

  @guide Path.expand("../../../docs/guides/from-one-machine-to-ten.md", __DIR__)

  @tag :tmp_dir
  @tag :capture_log
  test "every block of the guide runs and gives what it says", %{tmp_dir: folder} do
    blocks = Regex.scan(~r/```elixir\n(.*?)```/s, File.read!(@guide), capture: :all_but_first)
    assert length(blocks) == 3
    on_exit(fn -> if pid = Process.whereis(Situ.Cluster.Agent), do: Process.exit(pid, :kill) end)

    Enum.reduce(blocks, [folder: folder], fn [block], binding ->
      {value, binding} = Code.eval_string(block, binding)

      with [_, expected] <- Regex.run(~r/^# => (.*)\z/ms, block) do
        {expected, _} = Code.eval_string(String.replace(expected, "\n#", "\n"))
        assert value == expected, "#{block}\ngave #{inspect(value)}"
      end

      binding
    end)
  end
end
