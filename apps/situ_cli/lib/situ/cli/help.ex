defmodule Situ.CLI.Help do
  @moduledoc false
  # Formats the texts of `--help` from the verbs' tables.
  alias Situ.CLI.{Option, Verb}

  @width 100

  @spec format_overview([Verb.t()], %{String.t() => String.t()}) :: String.t()
  def format_overview(verbs, groups) do
    lines =
      verbs
      |> Enum.map(fn verb -> {hd(verb.words), verb} end)
      |> Enum.uniq_by(&elem(&1, 0))
      |> Enum.map(fn {word, verb} -> {word, Map.get(groups, word, verb.summary)} end)

    """
    Situ records, replays and shows timestamped streams.

    Usage: situ COMMAND [VERB] [ARGUMENTS] [OPTIONS]

    #{format_table(lines)}

      --version   print the version
      --help      print this text; `situ COMMAND --help` explains one command

    Exit status: 0 success, 1 failure (or damage or differences found), 2 wrong usage;
    130 stopped by Ctrl-C; 141 the reader of a pipe closed it.
    """
  end

  @doc "Formats the help of a group of verbs."
  @spec format_group(String.t(), String.t(), [Verb.t()]) :: String.t()
  def format_group(word, summary, verbs) do
    lines =
      for verb <- verbs do
        arguments =
          Enum.map_join(verb.arguments, " ", fn {n, spec} -> Verb.argument_label(n, spec) end)

        {String.trim(Enum.join(tl(verb.words), " ") <> " " <> arguments), verb.summary}
      end

    """
    Usage: situ #{word} VERB [ARGUMENTS] [OPTIONS]

    To #{summary}.

    #{format_table(lines)}

    `situ #{word} VERB --help` explains one verb. All verbs accept --json, --quiet and --help.
    """
  end

  @doc "Formats the help of one verb."
  @spec format_verb(Verb.t()) :: String.t()
  def format_verb(%Verb{} = verb) do
    [
      "Usage: #{Verb.usage_line(verb)}",
      to_sentence(verb.summary),
      if(verb.about != "", do: String.trim(verb.about)),
      format_arguments(verb),
      format_table(
        for option <- Verb.all_options(verb),
            do: {Option.label(option), option_description(option)}
      ),
      if(verb.aliases != [], do: "Aliases: #{Enum.join(verb.aliases, ", ")}."),
      "Exit status: 0 success, 1 failure, 2 wrong usage; 130 stopped by Ctrl-C; 141 the reader of a pipe closed it.",
      format_examples(verb.examples)
    ]
    |> Enum.reject(&(&1 in [nil, ""]))
    |> Enum.join("\n\n")
    |> Kernel.<>("\n")
  end

  defp to_sentence(text), do: "To " <> text <> "."

  defp format_arguments(verb) do
    format_table(
      for {name, spec} <- verb.arguments, do: {Verb.argument_label(name, spec), spec[:doc]}
    )
  end

  @doc "Returns the description of an option, with its default."
  @spec option_description(Option.t()) :: String.t()
  def option_description(option) do
    default =
      cond do
        option.default == nil -> ""
        option.type == :span -> " (default #{Situ.Time.format_duration(option.default)})"
        true -> " (default #{option.default})"
      end

    option.doc <> default <> if(option.many?, do: "; may be given several times", else: "")
  end

  defp format_examples([]), do: nil
  defp format_examples([one]), do: "Example: #{one}"
  defp format_examples(several), do: "Examples:\n" <> Enum.map_join(several, "\n", &("  " <> &1))

  defp format_table([]), do: ""

  defp format_table(rows) do
    widest =
      rows
      |> Enum.map(fn {left, _} -> String.length(left) end)
      |> Enum.filter(&(&1 <= 34))
      |> Enum.max(fn -> 34 end)

    Enum.map_join(rows, "\n", fn {left, right} ->
      [first | rest] = wrap_text(right, @width - widest - 5)
      indent = String.duplicate(" ", widest + 5)

      head =
        if String.length(left) > widest,
          do: "  #{left}\n#{indent}",
          else: "  #{String.pad_trailing(left, widest)}   "

      Enum.join([head <> first | Enum.map(rest, &(indent <> &1))], "\n")
    end)
  end

  @doc "Splits text into lines of at most `width` characters."
  @spec wrap_text(String.t(), pos_integer()) :: [String.t(), ...]
  def wrap_text(text, width) do
    text
    |> String.split()
    |> Enum.reduce([""], fn word, [line | lines] ->
      cond do
        line == "" -> [word | lines]
        String.length(line) + String.length(word) < width -> [line <> " " <> word | lines]
        true -> [word, line | lines]
      end
    end)
    |> Enum.reverse()
  end
end
