defmodule Situ.Studio.Upload do
  @moduledoc false
  # Receives a recording from a browser: a file, or the files of a folder, in one sequence of bytes. They are written to
  # a folder next to their destination, which is not listed (`Situ.Studio.Stores`). When all have arrived and the
  # recording opens, it is renamed, so a broken upload never appears in the list.
  #
  #     {:ok, upload} = Upload.start("recordings", "walk.csv", [{"walk.csv", 7}])
  #     {:ok, upload} = Upload.write(upload, "a,b\n1,2")
  #     {:ok, "walk.csv"} = Upload.finish(upload)
  alias Situ.{Error, Store, TempFolder}
  alias Situ.Recording.Formats
  alias Situ.Store.{AtomicFile, Folder}
  alias Situ.Studio.{Export, Stores}

  @enforce_keys [:folder, :staging, :name]
  defstruct [:folder, :staging, :name, :device, remaining: [], missing: 0, received: 0]

  @typedoc "`remaining` lists the files that have not begun, `missing` is the number of bytes missing in the open one."
  @type t :: %__MODULE__{
          folder: Path.t(),
          staging: Path.t(),
          name: String.t(),
          device: :file.fd() | nil,
          remaining: [file()],
          missing: non_neg_integer(),
          received: non_neg_integer()
        }

  @typedoc "The path of a file, which begins with the name of the upload, and its size in bytes."
  @type file :: {Path.t(), non_neg_integer()}

  @most_files 10_000
  @most_parts 8

  @doc """
  Starts an upload into `folder`. Characters that a name may not have become "-". Errors: `:bad_name`,
  `:unknown_format`, `:exists`, and errors of the file system.
  """
  @spec start(Path.t(), String.t(), [file()]) :: {:ok, t()} | {:error, Error.t()}
  def start(folder, name, files) do
    with :ok <- check_files(name, files),
         {:ok, name, files} <- clean_names(name, files),
         :ok <- check_format(name, files),
         :ok <- check_free(Path.join(folder, name)),
         {:ok, staging} <- TempFolder.create_folder("upload", folder) do
      open_next_file(%__MODULE__{folder: folder, staging: staging, name: name, remaining: files})
    end
  end

  defp check_files(_name, []),
    do: {:error, invalid_upload("the folder is empty", "choose a recording")}

  defp check_files(_name, files) when length(files) > @most_files,
    do:
      {:error,
       invalid_upload(
         "the folder has more than #{@most_files} files",
         "copy it into the studio's folder"
       )}

  defp check_files(name, files) do
    case Enum.find(files, &(not valid_file?(name, &1))) do
      nil ->
        :ok

      {path, _} ->
        {:error, invalid_upload("#{inspect(path)} is not a valid path", "rename the file")}
    end
  end

  defp valid_file?(name, {path, size}) do
    parts = if String.valid?(path), do: String.split(path, "/"), else: []

    match?([^name | _], parts) and length(parts) <= @most_parts and size >= 0 and
      Enum.all?(parts, &(&1 not in ["", ".", ".."] and &1 =~ ~r/\A[^\x00-\x1f\\]{1,200}\z/u))
  end

  # Names of downloads contain parentheses and other characters, as in "walk (1).csv".
  defp clean_names(name, files) do
    extension = name |> Path.extname() |> replace_characters()
    stem = name |> Path.rootname() |> replace_characters() |> String.trim_leading("-")
    clean = String.slice(stem, 0, 60 - String.length(extension)) <> extension

    with :ok <- Export.check_name(clean) do
      {:ok, clean,
       for({path, size} <- files, do: {String.replace_prefix(path, name, clean), size})}
    end
  end

  defp replace_characters(text), do: String.replace(text, ~r/[^\p{L}\p{N} ._-]+/u, "-")

  # A file must have a known extension. The files of a folder are checked when it is complete.
  defp check_format(name, [{name, _}]) do
    if Formats.for_file(name), do: :ok, else: {:error, unknown_format(name)}
  end

  defp check_format(_name, _files), do: :ok

  defp unknown_format(name) do
    Error.new(:unknown_format, "the studio cannot open #{name}",
      why:
        "it opens video, audio, CSV, MCAP, ROS bags, point clouds, tracks, robots, and folders of recordings",
      fix: "convert the file with `situ store import`, which reads more formats"
    )
  end

  defp check_free(path) do
    if File.exists?(path),
      do:
        {:error,
         Error.new(:exists, "#{Path.basename(path)} already exists",
           fix: "open it from the list, or rename the file before you add it"
         )},
      else: :ok
  end

  defp invalid_upload(what, fix), do: Error.new(:bad_upload, what, fix: fix)

  @doc "Writes the next bytes. Errors: `:bad_upload` for more bytes than announced, and errors of the file system."
  @spec write(t(), binary()) :: {:ok, t()} | {:error, Error.t()}
  def write(%__MODULE__{device: nil}, _bytes),
    do:
      {:error, invalid_upload("the page sent more bytes than it announced", "add the file again")}

  def write(%__MODULE__{missing: missing} = upload, bytes) when byte_size(bytes) > missing do
    <<head::binary-size(missing), rest::binary>> = bytes
    with {:ok, upload} <- write(upload, head), do: write(upload, rest)
  end

  def write(%__MODULE__{} = upload, bytes) do
    size = byte_size(bytes)

    case :file.write(upload.device, bytes) do
      :ok ->
        open_next_file(%{
          upload
          | missing: upload.missing - size,
            received: upload.received + size
        })

      {:error, reason} ->
        {:error, Folder.io_error("save #{upload.name}", reason)}
    end
  end

  # Closes a complete file and opens the next one.
  defp open_next_file(%{missing: missing} = upload) when missing > 0, do: {:ok, upload}

  defp open_next_file(%{device: nil, remaining: []} = upload), do: {:ok, upload}

  defp open_next_file(%{device: nil, remaining: [{path, size} | remaining]} = upload) do
    path = Path.join(upload.staging, path)

    with :ok <- File.mkdir_p(Path.dirname(path)),
         {:ok, device} <- :file.open(path, [:write, :raw, :binary, :exclusive]) do
      open_next_file(%{upload | device: device, missing: size, remaining: remaining})
    else
      {:error, reason} -> {:error, Folder.io_error("save #{upload.name}", reason)}
    end
  end

  defp open_next_file(upload) do
    synced = :file.sync(upload.device)
    :ok = :file.close(upload.device)

    case synced do
      :ok -> open_next_file(%{upload | device: nil})
      {:error, reason} -> {:error, Folder.io_error("save #{upload.name}", reason)}
    end
  end

  @doc "Returns whether all bytes have arrived."
  @spec complete?(t()) :: boolean()
  def complete?(upload), do: upload.device == nil and upload.remaining == []

  @doc """
  Moves a complete upload to its name, and returns the name. Errors: errors of opening the recording, and `:exists` if
  somebody else used the name in the meantime.
  """
  @spec finish(t()) :: {:ok, String.t()} | {:error, Error.t()}
  def finish(%__MODULE__{} = upload) do
    path = Path.join(upload.staging, upload.name)
    destination = Path.join(upload.folder, upload.name)

    with :ok <- check_opens(path),
         :ok <- check_free(destination),
         :ok <- AtomicFile.rename_synced(path, destination) do
      discard(upload)
      {:ok, upload.name}
    else
      {:error, %Error{} = error} -> {:error, error}
      {:error, reason} -> {:error, Folder.io_error("save #{upload.name}", reason)}
    end
  end

  defp check_opens(path) do
    cond do
      Store.exists?(path) or File.regular?(path) -> open_once(path)
      Stores.list_all(path) == {[], []} -> {:error, no_recording(path)}
      true -> :ok
    end
  end

  # The error does not name the hidden folder.
  defp open_once(path) do
    case Store.open(path) do
      {:ok, _recording} ->
        :ok

      {:error, error} ->
        why = String.replace(Exception.message(error), path, Path.basename(path))
        {:error, Error.new(error.code, "#{Path.basename(path)} cannot be opened", why: why)}
    end
  end

  defp no_recording(path) do
    Error.new(:not_found, "the folder #{Path.basename(path)} contains no recording",
      fix: "choose a folder that Situ recorded, such as Talk.0000"
    )
  end

  @doc "Deletes what an upload has received so far."
  @spec discard(t()) :: :ok
  def discard(%__MODULE__{} = upload) do
    if upload.device, do: :file.close(upload.device)
    TempFolder.remove_folder(upload.staging)
  end
end
