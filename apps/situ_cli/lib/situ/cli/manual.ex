defmodule Situ.CLI.Manual do
  @moduledoc false
  # Renders the manual from the verbs' tables: as a page for `man` (troff), and as Markdown for the API site.
  alias Situ.CLI.{Help, Option, Verb}

  @spec render_page([Verb.t()], String.t()) :: String.t()
  def render_page(verbs, version) do
    IO.iodata_to_binary([
      ".TH SITU 1 \"\" \"situ #{version}\" \"Situ\"\n",
      ".SH NAME\nsitu \\- records, replays and shows timestamped streams\n",
      ".SH SYNOPSIS\n.B situ\n.I COMMAND\n[\\fIVERB\\fR] [\\fIARGUMENTS\\fR] [\\fIOPTIONS\\fR]\n",
      ".SH COMMANDS\n",
      Enum.map(verbs, &format_verb/1),
      ".SH COMMON OPTIONS\n",
      Enum.map(Verb.common_options(), &format_option/1),
      ".SH EXIT STATUS\n0 success; 1 failure, or damage or differences found; 2 wrong usage; ",
      "130 stopped by Ctrl\\-C; 141 the reader of a pipe closed it.\n"
    ])
  end

  @doc "Renders the reference of all commands as Markdown: the text of `--help` of each."
  @spec render_markdown([Verb.t()], %{String.t() => String.t()}) :: String.t()
  def render_markdown(verbs, groups) do
    commands = Enum.chunk_by(verbs, &hd(&1.words))

    IO.iodata_to_binary([
      "# The command line\n\nThis page shows `situ --help` and the help of each command.\n\n",
      format_block(Help.format_overview(verbs, groups)),
      Enum.map(commands, &format_command(&1, groups))
    ])
  end

  defp format_command([%{words: [word]} = verb], _groups),
    do: ["## situ #{word}\n\n", format_block(Help.format_verb(verb))]

  defp format_command([%{words: [word | _]} | _] = verbs, groups) do
    [
      "## situ #{word}\n\n",
      format_block(Help.format_group(word, groups[word], verbs)),
      for verb <- verbs do
        ["### situ #{Enum.join(verb.words, " ")}\n\n", format_block(Help.format_verb(verb))]
      end
    ]
  end

  defp format_block(text), do: ["```text\n", String.trim_trailing(text), "\n```\n\n"]

  defp format_verb(verb) do
    usage = verb |> Verb.usage_line() |> String.replace_suffix(" [OPTIONS]", "")

    [
      ".SS #{escape_troff(usage)}\n",
      "To #{escape_troff(verb.summary)}.\n",
      if(verb.about != "",
        do: [".PP\n", verb.about |> String.trim() |> escape_troff(), "\n"],
        else: []
      ),
      for(
        {name, spec} <- verb.arguments,
        do: format_item(Verb.argument_label(name, spec), spec[:doc])
      ),
      Enum.map(verb.options, &format_option/1),
      for(example <- verb.examples, do: [".PP\nExample: \\fB", escape_troff(example), "\\fR\n"])
    ]
  end

  defp format_option(option),
    do: format_item(Option.label(option), Help.option_description(option))

  defp format_item(label, text),
    do: [".TP\n\\fB", escape_troff(label), "\\fR\n", escape_troff(text), "\n"]

  # Backslashes and hyphens are special in troff, and so are dots and quotes at the start of a line.
  defp escape_troff(text) do
    text
    |> String.replace("\\", "\\e")
    |> String.replace("-", "\\-")
    |> String.replace(~r/^([.'])/m, "\\\\&\\1")
  end
end
