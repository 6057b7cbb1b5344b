defmodule Situ.Infer.Voice.Detector do
  @moduledoc """
  The seam between `Situ.Infer.VoiceActivity` and whatever tells speech from other sound.

  | built in | tells it by | needs |
  |---|---|---|
  | `Situ.Infer.Voice.Silero` (`:silero`) | a network | ONNX Runtime |
  | `Situ.Infer.Voice.Energy` (`:energy`) | the level above the noise | nothing |

  Another is a module with these callbacks, named by the option `detector:`. It hears 16 kHz mono sound in chunks of 512
  samples (32 ms), one after the other, and may remember: its state is handed from call to call.
  """

  @type state :: term()

  @doc "A detector that has heard nothing; the options are those of `Situ.Infer.VoiceActivity`."
  @callback load(keyword()) :: {:ok, state()} | {:error, Situ.Error.t()}

  @doc "Forgets the sound before: there was a gap."
  @callback reset(state()) :: state()

  @doc """
  The probability (0..1) that somebody speaks in the next chunk: 512 samples as 32-bit floats of this machine's byte
  order, whose root mean square is `level`.
  """
  @callback step(state(), chunk :: binary(), level :: float()) ::
              {:ok, probability :: float(), state()} | {:error, Situ.Error.t()}
end
