defmodule Situ.CLI.Manual do
  @moduledoc false
  # Renders the manual page (troff, for `man`) from the verbs' tables.
  alias Situ.CLI.{Help, Option, Verb}

  @spec page([Verb.t()], String.t()) :: String.t()
  def page(verbs, version) do
    IO.iodata_to_binary([
      ".TH SITU 1 \"\" \"situ #{version}\" \"Situ\"\n",
      ".SH NAME\nsitu \\- records, replays and shows timestamped streams\n",
      ".SH SYNOPSIS\n.B situ\n.I COMMAND\n[\\fIVERB\\fR] [\\fIARGUMENTS\\fR] [\\fIOPTIONS\\fR]\n",
      ".SH COMMANDS\n",
      Enum.map(verbs, &verb/1),
      ".SH COMMON OPTIONS\n",
      Enum.map(Verb.common(), &option/1),
      ".SH EXIT STATUS\n0 success; 1 failure, or damage or differences found; 2 wrong usage; ",
      "130 stopped by Ctrl\\-C; 141 the reader of a pipe closed it.\n"
    ])
  end

  defp verb(verb) do
    usage = verb |> Verb.usage() |> String.replace_suffix(" [OPTIONS]", "")

    [
      ".SS #{escape(usage)}\n",
      "To #{escape(verb.summary)}.\n",
      if(verb.about != "", do: [".PP\n", verb.about |> String.trim() |> escape(), "\n"], else: []),
      for({name, spec} <- verb.arguments, do: item(Verb.argument(name, spec), spec[:doc])),
      Enum.map(verb.options, &option/1),
      for(example <- verb.examples, do: [".PP\nExample: \\fB", escape(example), "\\fR\n"])
    ]
  end

  defp option(option), do: item(Option.label(option), Help.described(option))
  defp item(label, text), do: [".TP\n\\fB", escape(label), "\\fR\n", escape(text), "\n"]

  # Backslashes and hyphens are special in troff, and so are dots and quotes at the start of a line.
  defp escape(text) do
    text
    |> String.replace("\\", "\\e")
    |> String.replace("-", "\\-")
    |> String.replace(~r/^([.'])/m, "\\\\&\\1")
  end
end
