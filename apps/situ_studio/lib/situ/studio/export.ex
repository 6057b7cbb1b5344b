defmodule Situ.Studio.Export do
  @moduledoc """
  A part of a recording as a recording of its own, beside it: an interval, of all streams or some.

      iex> {:error, error} = Situ.Studio.Export.new("../../etc", 0, 10, :all)
      iex> error.code
      :bad_name
      iex> {:ok, export} = Situ.Studio.Export.new(" talk 2 ", 0, 10, ["Mic"])
      iex> {export.name, Situ.Studio.Export.duration(export)}
      {"talk 2", 10}
  """
  alias Situ.Error
  alias Situ.Studio.Catalog.Item

  @enforce_keys [:name, :from, :to]
  defstruct [:name, :from, :to, streams: :all]

  @type t :: %__MODULE__{
          name: String.t(),
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          streams: :all | [String.t()]
        }

  # A name on every file system, and no way out of the folder.
  @name ~r/\A[\p{L}\p{N}][\p{L}\p{N} ._-]{0,59}\z/u

  @doc "Checks what a person typed. Times in ns, both ends included."
  @spec new(String.t(), Situ.Time.t(), Situ.Time.t(), :all | [String.t()]) ::
          {:ok, t()} | {:error, Error.t()}
  def new(name, from, to, streams) do
    name = String.trim(name)

    cond do
      check_name(name) != :ok ->
        check_name(name)

      to <= from ->
        {:error,
         Error.new(:empty, "there is nothing between the two ends of the selection",
           fix: "select with Shift and dragging over a timeline"
         )}

      streams == [] ->
        {:error, Error.new(:empty, "no streams are shown", fix: "take all streams")}

      true ->
        {:ok, %__MODULE__{name: name, from: from, to: to, streams: streams}}
    end
  end

  @doc "Whether a file of that name can be made: on every file system, and nowhere else than in its folder."
  @spec check_name(String.t()) :: :ok | {:error, Error.t()}
  def check_name(name) do
    if String.valid?(name) and name =~ @name do
      :ok
    else
      {:error,
       Error.new(:bad_name, "#{inspect(name)} cannot be the name of a file",
         why:
           "it has 1 to 60 letters, digits, spaces, dots, dashes, and begins with a letter or digit",
         fix: "choose another"
       )}
    end
  end

  @doc "How long it is, in ns."
  @spec duration(t()) :: Situ.Time.duration()
  def duration(%__MODULE__{from: from, to: to}), do: to - from

  @doc "Writes it beside the recording: `{:ok, path}` of the new one. Takes as long as it takes to copy."
  @spec run(t(), Item.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def run(%__MODULE__{} = export, %Item{kind: :store, path: path}) do
    some = if export.streams == :all, do: [], else: [streams: export.streams]

    Situ.Store.crop(
      path,
      {export.name, Path.dirname(path)},
      [from: export.from, to: export.to] ++ some
    )
  end

  def run(_, %Item{title: title}) do
    {:error, Error.new(:no_store, "#{title} is no recording on disk", fix: "open a recording")}
  end
end
