defmodule Situ.Studio.GuideTest do
  # Not async, because the snippets start servers under their own names.
  use ExUnit.Case, async: true

  @folder Path.expand("../../../../../docs/guides", __DIR__)

  for name <- ~w(studio-pipelines studio-serving) do
    guide = Path.join(@folder, name <> ".md")
    @external_resource guide

    snippets =
      ~r/```elixir\n(.*?)```/s
      |> Regex.scan(File.read!(guide), capture: :all_but_first)
      |> Enum.concat()

    for {code, i} <- Enum.with_index(snippets, 1) do
      test "runs snippet #{i} of #{name}" do
        Process.flag(:trap_exit, true)
        assert {_, bindings} = Code.eval_string(unquote(code), [], file: unquote(guide))

        for {:children, children} <- bindings, child <- children do
          assert %{start: {Situ.Studio, :start_link, _}} = Supervisor.child_spec(child, [])
        end
      end
    end
  end
end
