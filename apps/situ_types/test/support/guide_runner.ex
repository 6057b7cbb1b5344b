defmodule Situ.Test.GuideRunner do
  @moduledoc """
  Runs the Elixir blocks of a guide in order, as a reader would. Each block sees the variables and aliases of the
  previous blocks. A block that ends in `# => value` must return that value.

      defmodule LinksGuideTest do
        use ExUnit.Case, async: true

        @guide Path.expand("../../../docs/guides/links.md", __DIR__)

        test "every block of the guide returns the value in its comment" do
          assert Situ.Test.GuideRunner.run_blocks(@guide) > 5
        end
      end
  """

  @doc """
  Runs the blocks of the Markdown file at `path` and returns their number. `bindings:` are variables for the first
  block. Raises `ExUnit.AssertionError` with the line in the guide, the block, and its result or exception.
  """
  @spec run_blocks(Path.t(), keyword()) :: non_neg_integer()
  def run_blocks(path, opts \\ []) do
    env = Code.env_for_eval(file: path)
    blocks = list_blocks(File.read!(path))
    Enum.reduce(blocks, {Keyword.get(opts, :bindings, []), env}, &run_block/2)
    length(blocks)
  end

  @doc """
  Lists the Elixir blocks of a Markdown text, each with the number of its first line.

      iex> Situ.Test.GuideRunner.list_blocks("One:\\n\\n```elixir\\n1 + 1\\n# => 2\\n```\\n")
      [{4, "1 + 1\\n# => 2\\n"}]
  """
  @spec list_blocks(String.t()) :: [{pos_integer(), String.t()}]
  def list_blocks(text) do
    for [{at, length}] <-
          Regex.scan(~r/^```elixir\n\K.*?(?=^```)/ms, text, return: :index) do
      before = binary_part(text, 0, at)
      {length(String.split(before, "\n")), binary_part(text, at, length)}
    end
  end

  defp run_block({line, code}, {bindings, env}) do
    quoted = Code.string_to_quoted!(code, file: env.file, line: line)
    {value, bindings, env} = Code.eval_quoted_with_env(quoted, bindings, env)

    with [_, expected] <- Regex.run(~r/^# => (.*)\z/ms, code) do
      {expected, _} = expected |> String.replace("\n#", "\n") |> Code.eval_string([], env)
      value == expected || raise "the result is #{inspect(value)}"
    end

    {bindings, env}
  rescue
    error ->
      said = "#{Path.basename(env.file)}:#{line}: #{Exception.message(error)}\n#{code}"
      reraise ExUnit.AssertionError, [message: said], __STACKTRACE__
  end
end
