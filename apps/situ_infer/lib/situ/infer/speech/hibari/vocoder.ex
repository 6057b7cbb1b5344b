defmodule Situ.Infer.Speech.Hibari.Vocoder do
  @moduledoc false
  # Converts the output of Hibari's network to audio. The output has 80 spectra per second. Each
  # consists of a voiced part (`lh`, `theta`: magnitude and phase relative to pulses at the pitch
  # `f0`), noise (`ln`) and a part with independent phases (`lr`, `phi`).
  #
  # The short-time Fourier transform of the pulses and the inverse transform of the sum are
  # convolutions with the same waves. ONNX Runtime computes them in a graph that is built here,
  # with windows of 1200 samples every 300 samples at 24 kHz. The noise is the same for the same
  # text.
  alias Situ.{Error, Tensor}
  alias Situ.Infer.{Model, Onnx}

  @rate 24_000
  @window 1_200
  @hop 300
  @bins 601
  # The number of random samples, and the offset between the noise of one bin and the next.
  @noise 131_072
  @stride 811
  @most_frames 8_000

  @enforce_keys [:model, :noise]
  defstruct @enforce_keys
  @type t :: %__MODULE__{model: Model.t(), noise: binary()}

  @doc "Returns the sample rate in Hz."
  @spec sample_rate() :: pos_integer()
  def sample_rate, do: @rate

  @doc "Builds and loads the model, and generates the noise."
  @spec load() :: {:ok, t()} | {:error, Error.t()}
  def load do
    with {:ok, model} <-
           Model.from_bytes(build_graph(), "vocoder", warm_up: 0, schedule: :dirty, sessions: 1),
         do: {:ok, %__MODULE__{model: model, noise: generate_noise()}}
  end

  @doc "Converts the network's outputs, given by name, to audio as 32-bit floats."
  @spec synthesize_audio(t(), %{String.t() => Tensor.t()}) ::
          {:ok, binary()} | {:error, Error.t()}
  def synthesize_audio(%__MODULE__{} = vocoder, %{"f0" => %Tensor{shape: {1, frames}}} = spectrum)
      when frames in 3..@most_frames do
    inputs =
      spectrum
      |> Map.take(~w(lh theta ln lr phi))
      |> Map.merge(%{
        "pulses" => Tensor.new(pulse_train(spectrum["f0"]), :f32, {1, 1, frames * @hop}),
        "noise" => Tensor.new(noise_rows(vocoder.noise, frames), :f32, {1, 2 * @bins, frames}),
        "ones" => Tensor.new(:binary.copy(<<1.0::float-native-32>>, frames), :f32, {1, 1, frames})
      })

    with {:ok, %{"sound" => %{data: data}}} <- Model.run(vocoder.model, inputs),
         do: {:ok, binary_part(data, div(@window, 2) * 4, frames * @hop * 4)}
  end

  def synthesize_audio(%__MODULE__{}, %{"f0" => %Tensor{shape: shape}}) do
    {:error,
     Error.new(:synthesis_failed, "unexpected spectra of shape #{inspect(shape)} for a sentence",
       fix: "use shorter sentences"
     )}
  end

  @doc """
  Returns the pulses of a pitch (Hz, one number per frame of #{@hop} samples) as 32-bit floats. They contain all
  harmonics below 11 kHz at the same strength. A pitch below 40 Hz means unvoiced and gives no pulses.
  """
  @spec pulse_train(Tensor.t()) :: binary()
  def pulse_train(%Tensor{} = f0) do
    [first | _] = pitches = Tensor.to_list(f0)

    {parts, _, _} =
      pitches
      |> Enum.zip(tl(pitches) ++ [List.last(pitches)])
      |> Enum.reduce({[], first, 0.0}, fn {now, next}, {parts, before, phase} ->
        {part, phase} = frame_samples(0, before, now, next, phase, [])
        {[part | parts], now, phase}
      end)

    parts |> Enum.reverse() |> IO.iodata_to_binary()
  end

  defp frame_samples(@hop, _before, _now, _next, phase, samples),
    do: {Enum.reverse(samples), phase}

  # Interpolates the pitch linearly from the middle of a frame to the middle of the next.
  defp frame_samples(j, before, now, next, phase, samples) do
    u = (j + 0.5) / @hop

    hz =
      if j < div(@hop, 2),
        do: before * (0.5 - u) + now * (0.5 + u),
        else: now * (1.5 - u) + next * (u - 0.5)

    phase = phase + max(hz, 40.0) / @rate
    phase = phase - trunc(phase)
    x = if hz > 40.0, do: pulse_sample(phase * 2 * :math.pi(), hz), else: 0.0
    frame_samples(j + 1, before, now, next, phase, [<<x::float-native-32>> | samples])
  end

  # Computes the sum of cosines up to the last harmonic in closed form.
  defp pulse_sample(t, hz) do
    harmonics = floor(11_000 / hz) + 0.5
    s = 2 * :math.sin(t / 2)
    if abs(s) <= 2.0e-3, do: harmonics - 0.5, else: :math.sin(harmonics * t) / s - 0.5
  end

  defp generate_noise do
    {numbers, _} =
      Enum.map_reduce(1..@noise, :rand.seed_s(:exsss, 24_000), fn _, state ->
        {x, state} = :rand.normal_s(state)
        {<<x::float-native-32>>, state}
      end)

    IO.iodata_to_binary(numbers)
  end

  defp noise_rows(noise, frames) do
    for bin <- 0..(2 * @bins - 1), into: <<>> do
      binary_part(noise, 4 * rem(bin * @stride, @noise - frames), 4 * frames)
    end
  end

  defp build_graph do
    spectrum = for name <- ~w(lh theta ln lr phi), do: {name, :f32, {1, @bins, nil}}

    Onnx.encode(
      inputs:
        spectrum ++
          [
            {"pulses", :f32, {1, 1, nil}},
            {"noise", :f32, {1, 2 * @bins, nil}},
            {"ones", :f32, {1, 1, nil}}
          ],
      outputs: [{"sound", :f32, {1, 1, nil}}],
      constants: graph_constants(),
      nodes:
        pulses_nodes() ++
          spectrum_nodes("lh", [
            {"Tanh", ["theta"], ["turn"], []},
            {"Mul", ["turn", "pi"], ["lh_turn"], []}
          ]) ++
          spectrum_nodes("lr", [{"Identity", ["phi"], ["lr_turn"], []}]) ++
          sum_nodes() ++ inverse_nodes()
    )
  end

  # Computes the transform of the pulses; the last window extends past the frames and is dropped.
  defp pulses_nodes do
    [
      {"Pad", ["pulses", "pads"], ["padded"], [mode: "reflect"]},
      {"Conv", ["padded", "waves"], ["windows"], [strides: [@hop]]},
      {"Slice", ["windows", "zero", "minus_one", "frames"], ["pulsed"], []},
      {"Mul", ["pulsed", "pulse_scale"], ["source"], []},
      {"Slice", ["source", "zero", "bins", "rows"], ["re"], []},
      {"Slice", ["source", "bins", "all", "rows"], ["im"], []}
    ]
  end

  # Converts a log magnitude and a phase to real and imaginary parts.
  defp spectrum_nodes(name, turn_nodes) do
    turn_nodes ++
      [
        {"Min", [name, "seven"], [name <> "_low"], []},
        {"Exp", [name <> "_low"], [name <> "_size"], []},
        {"Cos", [name <> "_turn"], [name <> "_cos"], []},
        {"Sin", [name <> "_turn"], [name <> "_sin"], []},
        {"Mul", [name <> "_size", name <> "_cos"], [name <> "_re"], []},
        {"Mul", [name <> "_size", name <> "_sin"], [name <> "_im"], []}
      ]
  end

  defp sum_nodes do
    [
      {"Mul", ["re", "lh_re"], ["rr"], []},
      {"Mul", ["im", "lh_im"], ["ii"], []},
      {"Mul", ["re", "lh_im"], ["ri"], []},
      {"Mul", ["im", "lh_re"], ["ir"], []},
      {"Sub", ["rr", "ii"], ["voiced_re"], []},
      {"Add", ["ri", "ir"], ["voiced_im"], []},
      {"Add", ["voiced_re", "lr_re"], ["tonal_re"], []},
      {"Add", ["voiced_im", "lr_im"], ["tonal_im"], []},
      {"Concat", ["tonal_re", "tonal_im"], ["tonal"], [axis: 1]},
      {"Min", ["ln", "seven"], ["ln_low"], []},
      {"Exp", ["ln_low"], ["ln_size"], []},
      {"Concat", ["ln_size", "ln_size"], ["ln_both"], [axis: 1]},
      {"Mul", ["noise", "ln_both"], ["noisy"], []},
      {"Add", ["tonal", "noisy"], ["whole"], []}
    ]
  end

  # Overlap-adds the windows, and divides by the sum of their squares.
  defp inverse_nodes do
    [
      {"Mul", ["whole", "scale"], ["scaled"], []},
      {"ConvTranspose", ["scaled", "waves"], ["laid"], [strides: [@hop]]},
      {"ConvTranspose", ["ones", "squares"], ["weights"], [strides: [@hop]]},
      {"Max", ["weights", "least"], ["at_least"], []},
      {"Div", ["laid", "at_least"], ["sound"], []}
    ]
  end

  defp graph_constants do
    number = &Tensor.from_list([&1], :f32, {1})
    index = &Tensor.from_list([&1], :s64, {1})

    scale =
      for _ <- 1..2,
          bin <- 0..(@bins - 1),
          do: if(bin in [0, @bins - 1], do: 1, else: 2) / @window

    squares = for n <- 0..(@window - 1), do: :math.pow(hann_weight(n), 2)

    %{
      "pads" => Tensor.from_list([0, 0, 600, 0, 0, 600], :s64, {6}),
      "waves" => Tensor.new(windowed_waves(), :f32, {2 * @bins, 1, @window}),
      "squares" => Tensor.from_list(squares, :f32, {1, 1, @window}),
      "scale" => Tensor.from_list(scale, :f32, {1, 2 * @bins, 1}),
      "pulse_scale" => number.(4 / @window),
      "pi" => number.(:math.pi()),
      "seven" => number.(7.0),
      "least" => number.(1.0e-11),
      "zero" => index.(0),
      "minus_one" => index.(-1),
      "bins" => index.(@bins),
      "all" => index.(2 * @bins),
      "rows" => index.(1),
      "frames" => index.(2)
    }
  end

  # Returns the windowed cos and -sin of each bin. All bins share one table of angles for a full period.
  defp windowed_waves do
    angles = for n <- 0..(@window - 1), do: 2 * :math.pi() * n / @window
    cosines = angles |> Enum.map(&:math.cos/1) |> List.to_tuple()
    sines = angles |> Enum.map(&(-:math.sin(&1))) |> List.to_tuple()
    window = for n <- 0..(@window - 1), do: {n, hann_weight(n)}

    for table <- [cosines, sines], bin <- 0..(@bins - 1), {n, w} <- window, into: <<>> do
      <<elem(table, rem(bin * n, @window)) * w::float-native-32>>
    end
  end

  defp hann_weight(n), do: 0.5 - 0.5 * :math.cos(2 * :math.pi() * n / @window)
end
