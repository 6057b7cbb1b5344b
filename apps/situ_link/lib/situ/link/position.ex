defmodule Situ.Link.Position do
  @moduledoc false
  # Saves the positions of a link's streams in a file that survives a kill or a power failure at
  # any moment.
  #
  # A position is an originating time of the sender's clock. All messages up to it were consumed.
  # The file is JSON. It is written under a temporary name, synced to the disk and then renamed,
  # so that a complete file always exists.
  alias Situ.{Error, JSON}
  alias Situ.Link.Address

  @type t :: %{String.t() => Situ.Time.t()}

  @doc "Returns the default path of the file for the positions of a link."
  @spec default_path(Address.t()) :: Path.t()
  def default_path(%Address{} = address) do
    state = System.get_env("XDG_STATE_HOME") || Path.join(System.user_home!(), ".local/state")
    file = address |> Address.to_string() |> String.replace(~r/[^A-Za-z0-9.-]+/, "_")
    Path.join([state, "situ", "links", file <> ".json"])
  end

  @doc "Loads the positions. Returns an empty map if the file does not exist. Errors: `:bad_position`, `:io`."
  @spec load(Path.t()) :: {:ok, t()} | {:error, Error.t()}
  def load(path) do
    with {:ok, text} <- File.read(path),
         {:ok, %{} = map} <- JSON.decode(text),
         true <- Enum.all?(map, fn {_, time} -> is_integer(time) end) do
      {:ok, map}
    else
      {:error, :enoent} ->
        {:ok, %{}}

      {:error, reason} when is_atom(reason) ->
        {:error,
         Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))}

      _ ->
        {:error,
         Error.new(:bad_position, "#{path} does not contain the positions of a link",
           fix: "delete it to start from the beginning, or choose another file with position:"
         )}
    end
  end

  @doc """
  Saves the positions. Errors: `:io`.

      iex> path = Path.join(System.tmp_dir!(), "situ-doc-position.json")
      iex> Situ.Link.Position.save(path, %{"imu" => 1_700_000_000_000_000_001})
      :ok
      iex> Situ.Link.Position.load(path)
      {:ok, %{"imu" => 1_700_000_000_000_000_001}}
      iex> File.rm!(path)
      iex> Situ.Link.Position.load(path)
      {:ok, %{}}
  """
  @spec save(Path.t(), t()) :: :ok | {:error, Error.t()}
  def save(path, positions) do
    tmp = path <> ".unfinished"

    with :ok <- File.mkdir_p(Path.dirname(path)),
         {:ok, file} <- File.open(tmp, [:write, :raw, :binary]),
         :ok <- write_synced(file, JSON.encode(positions)),
         :ok <- File.rename(tmp, path) do
      :ok
    else
      {:error, reason} ->
        {:error,
         Error.new(:io, "cannot save the positions of a link in #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "make the folder writable, or choose another file with position:"
         )}
    end
  end

  defp write_synced(file, text) do
    with :ok <- :file.write(file, text), do: :file.sync(file)
  after
    File.close(file)
  end
end
