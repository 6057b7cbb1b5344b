defmodule Situ.Infer.Voice.Detector do
  @moduledoc """
  The behaviour of voice detectors, which distinguish speech from other audio for `Situ.Infer.VoiceActivity`.

  | built in | method | needs |
  |---|---|---|
  | `:silero` | a network | ONNX Runtime |
  | `:energy` | the level above the noise | nothing |

  To add another detector, write a module with these callbacks and name it by the option `detector:`. It receives 16 kHz
  mono audio in consecutive chunks of 512 samples (32 ms). Its state is passed from call to call.
  """

  @type state :: term()

  @doc "Returns the initial state of the detector; it takes the options of `Situ.Infer.VoiceActivity`."
  @callback load(keyword()) :: {:ok, state()} | {:error, Situ.Error.t()}

  @doc "Resets the state after a gap in the audio."
  @callback reset(state()) :: state()

  @doc """
  Returns the probability (0..1) that somebody speaks in the next chunk: 512 samples as 32-bit floats in native byte
  order, with the root mean square `level`.
  """
  @callback step(state(), chunk :: binary(), level :: float()) ::
              {:ok, probability :: float(), state()} | {:error, Situ.Error.t()}
end
