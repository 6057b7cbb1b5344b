defmodule Situ.EditLog.Entry do
  @moduledoc false
  # One entry of a log: an operation (`do`), its number, and who made it, when, and with which program. `kind` is `edit`,
  # `undo` or `redo` (of the entry `of`), `name` (of the version `of`), `restore` (of the version `of`), or `outside`: the
  # change of a program that does not use the log.
  alias Situ.Store.FileLock

  @kinds ~w(edit undo redo name restore outside)

  @enforce_keys [:kind, :do]
  defstruct [:kind, :do, :n, :at, :by, :program, :host, :of, :note]

  @type t :: %__MODULE__{
          kind: String.t(),
          do: map(),
          n: pos_integer() | nil,
          at: String.t() | nil,
          by: String.t() | nil,
          program: String.t() | nil,
          host: String.t() | nil,
          of: term(),
          note: String.t() | nil
        }

  @doc """
  Builds an entry of this program. Options: `by:` (default: the user of this process), `of:`, `note:`, and `at:`
  (default: the time now).
  """
  @spec new(String.t(), map(), keyword()) :: t()
  def new(kind, operation, opts \\ []) when kind in @kinds do
    author = FileLock.describe_self()

    %__MODULE__{
      kind: kind,
      do: operation,
      at: opts[:at] || author.since,
      by: opts[:by] || author.user,
      program: opts[:program] || author.program,
      host: author.host,
      of: opts[:of],
      note: opts[:note]
    }
  end

  @doc "Returns whether two entries were made by the same person with the same program, on the same computer."
  @spec same_author?(t(), t()) :: boolean()
  def same_author?(a, b), do: {a.by, a.program, a.host} == {b.by, b.program, b.host}

  @doc "Converts an entry to a JSON object; the number is first."
  @spec to_json(t()) :: {[{String.t(), term()}]}
  def to_json(entry) do
    members =
      for key <- [:n, :kind, :at, :by, :program, :host, :of, :note, :do],
          value = Map.fetch!(entry, key),
          value != nil,
          do: {Atom.to_string(key), value}

    {members}
  end

  @doc "Reads an entry that `to_json/1` returned."
  @spec parse(map()) :: {:ok, t()} | :error
  def parse(%{"n" => n, "kind" => kind, "do" => %{} = operation} = json)
      when is_integer(n) and kind in @kinds do
    texts = for key <- ~w(at by program host note), do: json[key]

    if Enum.all?(texts, &(&1 == nil or is_binary(&1))) do
      [at, by, program, host, note] = texts
      entry = %__MODULE__{kind: kind, do: operation, n: n, of: json["of"], note: note}
      {:ok, %{entry | at: at, by: by, program: program, host: host}}
    else
      :error
    end
  end

  def parse(_), do: :error
end
