defmodule Situ.CLI.HistoryTable do
  @moduledoc false
  # Prints the history of a dataset or of a layer of annotations, and the differences between two versions.
  alias Situ.CLI.{Option, Output}

  @doc "Returns the option that limits the length of a history."
  @spec limit_option() :: Option.t()
  def limit_option,
    do: Option.new(:limit, :integer, "the number of latest operations to list", default: 50)

  @doc "Prints the latest operations, newest last."
  @spec print_history([map()], keyword()) :: 0
  def print_history(entries, opts) do
    latest = Enum.take(entries, -opts[:limit])

    cond do
      opts[:json] -> Output.print_json(latest)
      latest == [] -> Output.puts("There are no edits yet.")
      true -> print_rows(latest, length(entries) - length(latest))
    end

    0
  end

  defp print_rows(entries, earlier) do
    if earlier > 0,
      do: Output.puts("#{Output.format_count(earlier, "earlier operation")} (--limit shows more)")

    rows =
      for e <- entries do
        time = e.at |> to_string() |> String.replace(~r/\.?0*Z$/, "") |> String.replace("T", " ")
        ["#{e.version}", time, e.by || "unknown", e.program || "", e.what]
      end

    Output.print_table([["version", "time (UTC)", "who", "program", "what"] | rows], 5)
  end

  @doc "Prints differences in plain words."
  @spec print_differences([String.t()], keyword()) :: 0
  def print_differences(lines, opts) do
    cond do
      opts[:json] -> Output.print_json(lines)
      lines == [] -> Output.puts("no difference")
      true -> for line <- lines, do: Output.puts(line)
    end

    0
  end

  @doc "Returns the arguments of a version and of the version to compare it with."
  @spec version_argument(String.t()) :: keyword()
  def version_argument(doc), do: [kind: :text, doc: "#{doc}: a number or a name"]
end
