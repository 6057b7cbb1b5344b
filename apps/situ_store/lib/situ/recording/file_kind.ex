defmodule Situ.Recording.FileKind do
  @moduledoc """
  A kind of file that Situ reads or writes, with the operations that work for it. `situ formats` lists all kinds.

    * `name`: an atom that options such as `--format` use.
    * `title`: for people.
    * `extensions`: in lower case, with the dot.
    * `signatures`: the bytes that such files contain at a position, `{position, bytes}`; a file with one of them opens
      whatever its extension.
    * `open`: the `Situ.Recording.Format` with which such files open as recordings, or `nil`.
    * `import`: whether `situ store import` creates a stream from such a file (a table).
    * `export`: the extensions with which `situ store save` writes such files.
    * `program`: a program that must be installed, or `nil`.

  A kind is declared in one place: by `c:Situ.Recording.Format.kinds/0`, or by a module that an application names in
  `env: [file_kinds: [MyKinds]]` and that has a function `kinds/0`. Several declarations of one name are joined.
  """
  @enforce_keys [:name, :title]
  defstruct [
    :name,
    :title,
    :open,
    :program,
    extensions: [],
    signatures: [],
    import: false,
    export: []
  ]

  @type t :: %__MODULE__{
          name: atom(),
          title: String.t(),
          extensions: [String.t()],
          signatures: [{position :: non_neg_integer(), binary()}],
          open: module() | nil,
          import: boolean(),
          export: [String.t()],
          program: String.t() | nil
        }

  @doc "Joins two declarations of the same kind."
  @spec join(t(), t()) :: t()
  def join(%__MODULE__{name: name} = a, %__MODULE__{name: name} = b) do
    %{
      a
      | extensions: Enum.uniq(a.extensions ++ b.extensions),
        signatures: Enum.uniq(a.signatures ++ b.signatures),
        open: a.open || b.open,
        import: a.import or b.import,
        export: Enum.uniq(a.export ++ b.export),
        program: a.program || b.program
    }
  end

  @doc "Returns whether the first bytes of a file have a signature of this kind."
  @spec signed?(t(), binary()) :: boolean()
  def signed?(%__MODULE__{signatures: signatures}, bytes) do
    Enum.any?(signatures, fn {position, signature} ->
      size = byte_size(signature)

      byte_size(bytes) >= position + size and binary_part(bytes, position, size) == signature
    end)
  end
end
