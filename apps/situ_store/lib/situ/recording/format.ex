defmodule Situ.Recording.Format do
  @moduledoc """
  The behaviour of file formats that open as recordings.

  A module of a format implements `Situ.Recording`, too: `open/2` returns the state that its callbacks receive.

      defmodule MyFormat do
        @behaviour Situ.Recording
        @behaviour Situ.Recording.Format

        @impl true
        def extensions, do: [".my"]
        ...
      end

  `Situ.Store.open/2` chooses the format of a file by its extension, unless its option `reader:` names the module.
  Formats from the configuration come first, then the formats of loaded applications:

      config :situ_store, formats: [MyFormat]

      # in `application/0` of a library's mix.exs
      [env: [recording_formats: [MyFormat]]]
  """

  @doc "Returns the file name extensions in lower case, with the dot."
  @callback extensions() :: [String.t()]
  @doc "Opens the file. The options are specific to the format."
  @callback open(Path.t(), opts :: keyword()) ::
              {:ok, Situ.Recording.state()} | Situ.Recording.error()
  @doc """
  Returns the schemes of addresses of remote recordings, such as `["situ"]` for `situ://...`. `open/2` and
  `list_recordings/1` receive the complete address.
  """
  @callback schemes() :: [String.t()]
  @doc """
  Returns the local path at which the recording of an address opens, for formats whose recordings are fetched to this
  machine. `open/2` is not called for such an address.
  """
  @callback locate(address :: String.t()) :: {:ok, Path.t()} | Situ.Recording.error()
  @doc """
  Resolves `path`, a folder or the name of one, to a recording that is a folder, or returns `nil`. `open/2` receives the
  result.
  """
  @callback resolve(Path.t()) :: Path.t() | nil
  @doc "Lists the recordings of this format directly in this folder, in the form that `resolve/1` returns."
  @callback list_recordings(folder :: Path.t()) :: [Path.t()]
  @doc """
  Returns the options for opening a recording to copy it into a store without loss. `times` selects the timestamps in
  headers or the times of recording.
  """
  @callback import_options(times :: :header | :record) :: keyword()

  @doc """
  Returns the kinds of files of this format, for `situ formats`, and so that files open by their first bytes, too.
  Without this callback, there is one kind with the format's extensions.
  """
  @callback kinds() :: [Situ.Recording.FileKind.t()]

  @optional_callbacks schemes: 0,
                      locate: 1,
                      resolve: 1,
                      list_recordings: 1,
                      import_options: 1,
                      kinds: 0
end
