defmodule Situ.Livebook.NotebooksTest do
  # Runs the code cells of the notebooks in their order, with shared variables, as Livebook does. A cell that ends in
  # `# => value` returns that value. The result of every cell is rendered.
  use ExUnit.Case, async: false
  import ExUnit.CaptureIO
  import Kino.Test

  @moduletag :capture_log
  @moduletag :tmp_dir
  @folder Path.expand("../notebooks", __DIR__)
  setup :configure_livebook_bridge

  for path <- Path.wildcard(Path.join(@folder, "*.livemd")) do
    @tag timeout: 120_000
    test "the cells of #{Path.basename(path)} run", %{tmp_dir: dir} do
      [_install | cells] =
        ~r/^```elixir\n(.*?)^```/ms
        |> Regex.scan(File.read!(unquote(path)), capture: :all_but_first)
        |> List.flatten()

      assert length(cells) >= 3

      output =
        capture_io(fn ->
          File.cd!(dir, fn -> Enum.reduce(cells, {[], Code.env_for_eval([])}, &run_cell/2) end)
        end)

      assert is_binary(output)
    end
  end

  # Later cells have the variables and aliases of earlier ones.
  defp run_cell(code, {binding, env}) do
    {value, binding, env} =
      code |> Code.string_to_quoted!() |> Code.eval_quoted_with_env(binding, env)

    check_value(Regex.run(~r/# => (.*)\n\z/, code), value, binding, code)
    assert %{type: _} = Kino.Render.to_livebook(value)
    {binding, env}
  end

  defp check_value(nil, _value, _binding, _code), do: :ok

  defp check_value([_, text], value, binding, code) do
    {expected, _} = Code.eval_string(text, binding)
    assert value == expected, code
  end

  test "the notebooks are made from the current guides" do
    before =
      for path <- Path.wildcard(Path.join(@folder, "*.livemd")), do: {path, File.read!(path)}

    Code.eval_file(Path.join(@folder, "make.exs"))
    for {path, text} <- before, do: assert(File.read!(path) == text, "run notebooks/make.exs")
  end
end
