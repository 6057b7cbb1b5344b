defmodule Situ.EditLog.Entry do
  @moduledoc false
  # One entry of a log: an operation (`do`), its number, and who made it, when, and with which program. `kind` is
  # `edit`, `undo` or `redo` (of the entry `of`), `name` (of the version `of`), `restore` (of the version `of`), or
  # `outside`: the change of a program that does not use the log. `file` is the version that the document's file
  # contained then, which shows whether an older file was put back later.
  alias Situ.EditLog.Changes
  alias Situ.Store.FileLock

  @kinds ~w(edit undo redo name restore outside)

  @enforce_keys [:kind, :do]
  defstruct [:kind, :do, :n, :at, :by, :user, :program, :host, :of, :note, :file]

  @type t :: %__MODULE__{
          kind: String.t(),
          do: map(),
          n: pos_integer() | nil,
          at: String.t() | nil,
          by: String.t() | nil,
          user: String.t() | nil,
          program: String.t() | nil,
          host: String.t() | nil,
          of: term(),
          note: String.t() | nil,
          file: non_neg_integer() | nil
        }

  @doc """
  Builds an entry of this program. Options: `by:` (the person, if it is not the user of the computer), `of:`, `note:`,
  `file:`, `program:`, and `at:` (default: the time now). Nobody knows who made an `outside` change.
  """
  @spec new(String.t(), map(), keyword()) :: t()
  def new(kind, operation, opts \\ []) when kind in @kinds do
    author = FileLock.describe_self()

    %__MODULE__{
      kind: kind,
      do: operation,
      at: opts[:at] || author.since,
      by: opts[:by],
      user: if(kind != "outside", do: author.user),
      program: opts[:program] || author.program,
      host: author.host,
      of: opts[:of],
      note: opts[:note],
      file: opts[:file]
    }
  end

  @doc "Returns whether the same user made two entries on the same computer, with any program."
  @spec same_user?(t(), t()) :: boolean()
  def same_user?(a, b), do: {a.user, a.host} == {b.user, b.host}

  @doc "Converts an entry to a JSON object; the number is first."
  @spec to_json(t()) :: {[{String.t(), term()}]}
  def to_json(entry) do
    members =
      for key <- [:n, :kind, :at, :by, :user, :program, :host, :of, :note, :file, :do],
          value = Map.fetch!(entry, key),
          value != nil,
          do: {Atom.to_string(key), value}

    {members}
  end

  @doc "Reads an entry that `to_json/1` returned."
  @spec parse(map()) :: {:ok, t()} | :error
  def parse(%{"n" => n, "kind" => kind, "do" => %{} = operation} = json)
      when is_integer(n) and kind in @kinds do
    texts = for key <- ~w(at by user program host note), do: json[key]

    if valid_changes?(operation["changes"]) and Enum.all?(texts, &(&1 == nil or is_binary(&1))) do
      [at, by, user, program, host, note] = texts
      entry = %__MODULE__{kind: kind, do: operation, n: n, of: json["of"], note: note}
      file = if is_integer(json["file"]), do: json["file"]
      {:ok, %{entry | at: at, by: by, user: user, program: program, host: host, file: file}}
    else
      :error
    end
  end

  def parse(_), do: :error

  defp valid_changes?(nil), do: true
  defp valid_changes?(changes), do: is_list(changes) and Enum.all?(changes, &Changes.change?/1)
end
