defmodule Situ.CLI.FileKinds do
  @moduledoc false
  # `situ formats`: lists the kinds of files that Situ reads and writes, from `Situ.Recording.Formats.list_kinds/0`.
  # The verbs that write files take their formats from here.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Output, Recording, Verb}
  alias Situ.Recording.{FileKind, Formats}

  # Pages are written by the studio, which only the command line knows.
  @page %FileKind{
    name: :html,
    title: "HTML page that opens without a server",
    extensions: [".html"],
    export: [".html"]
  }

  @impl true
  def verbs do
    [
      %Verb{
        words: ["formats"],
        summary: "list the kinds of files that Situ reads and writes",
        about: """
        "open": the file opens as a recording in all commands, in the studio and with Situ.Store.open. "import": it is a
        table, and `situ store import` makes a stream of it. "write": `situ store save` and `situ store convert` write
        it. Files with a signature ("by content") open whatever their extension. Folders (stores, \\psi stores) and
        addresses (situ://, s3://) are not files and open as well.
        """,
        arguments: [],
        options: [],
        examples: ["situ formats --json | jq '.[].extensions'"],
        run: &show_kinds/2
      }
    ]
  end

  defp show_kinds(_arguments, opts) do
    kinds = list_kinds()

    if opts[:json],
      do: Output.print_json(Enum.map(kinds, &describe_kind/1)),
      else:
        Output.print_table(
          [["kind", "extensions", "can", "needs"] | Enum.map(kinds, &kind_row/1)],
          4
        )

    0
  end

  defp describe_kind(kind) do
    %{
      name: kind.name,
      title: kind.title,
      extensions: kind.extensions,
      open: kind.open != nil,
      import: kind.import,
      write: kind.export,
      by_content: kind.signatures != [],
      needs: kind.program
    }
  end

  @doc "Returns the cells of a kind: its title, its extensions, what Situ can do with it, and the program it needs."
  @spec kind_row(FileKind.t()) :: [String.t()]
  def kind_row(kind) do
    can =
      for {word, true} <- [
            {"open", kind.open != nil},
            {"import", kind.import},
            {"write", kind.export != []},
            {"by content", kind.signatures != []}
          ],
          do: word

    [kind.title, Enum.join(kind.extensions, " "), Enum.join(can, ", "), kind.program || "-"]
  end

  @doc "Lists all kinds."
  @spec list_kinds() :: [FileKind.t()]
  def list_kinds do
    Recording.load_formats([])
    Formats.list_kinds() ++ [@page]
  end

  @doc "Lists the kinds that `situ store save` writes."
  @spec list_exports() :: [FileKind.t()]
  def list_exports, do: Enum.filter(list_kinds(), &(&1.export != []))

  @doc "Returns the values of `--format`. Pages are known by their extension."
  @spec export_words() :: [String.t()]
  def export_words,
    do: for(kind <- list_exports(), kind != @page, do: Atom.to_string(kind.name))

  @doc "Returns the name of the kind for a value of `--format`, or `nil`."
  @spec find_export(String.t() | nil) :: atom()
  def find_export(word),
    do: Enum.find_value(list_exports(), &(Atom.to_string(&1.name) == word && &1.name))
end
