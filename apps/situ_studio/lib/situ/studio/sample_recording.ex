defmodule Situ.Studio.SampleRecording do
  @moduledoc false
  # The behaviour of a recording that the studio can make for people who have none. An application registers its module
  # in the `env` of its `application/0`: `env: [sample_recordings: [MyApp.Sample]]`.
  alias Situ.Error

  @doc "Describes the contents of the recording, in one sentence."
  @callback describe() :: String.t()

  @doc "Makes the recording in a folder and calls `report` with the progress, 0.0 to 1.0. Returns the recording's path."
  @callback create(Path.t(), report :: (float() -> term())) ::
              {:ok, Path.t()} | {:error, Error.t()}

  @doc "Returns the modules that loaded applications have registered."
  @spec list_samples() :: [module()]
  def list_samples do
    for {app, _, _} <- Application.loaded_applications(),
        module <- Application.get_env(app, :sample_recordings, []),
        do: module
  end
end
