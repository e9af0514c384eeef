// ExWarp's predictor: a network of fully connected layers in 8-bit integers, and its decision.
//
// The machine of the paper (section IV-C, "Hardware Implementation of the Predictor") as
// exwarp_cli/accelerator/mac_array.py lays it out: cores with MACS multiply-accumulate units each, one
// adder, one multiplier, a pipeline of four stages and a memory. Inputs and neurons are dealt to the
// cores in turn: number i belongs to core i % CORES and is in its slot i / CORES.
//
// Use: write the state's numbers in their order with `state_write`, raise `start` for a cycle, and wait
// until `done` rises. The next state is written after that.
// `busy` is high for as many cycles as the model counts.

`default_nettype none

module exwarp_predictor #(
    `include "exwarp_parameters.vh"
) (
    input wire clk,
    input wire reset,

    input wire state_write,
    input wire signed [31:0] state_value,  // Q16.16

    input wire start,
    output wire busy,
    output reg done,
    output reg choice,  // 0 warp, 1 extrapolate; a tie is 0
    output reg signed [31:0] output_warp,
    output reg signed [31:0] output_extrapolate,

    // Weights that the cores' memories do not hold, in the order in which they are read: word after
    // word of all cores that need one, core 0 first, the lowest bytes first. Begins anew with every
    // start.
    input wire refill_valid,
    output wire refill_ready,
    input wire [8 * PORT - 1:0] refill_data
);
    localparam ADDRESS = $clog2(DEPTH);  // of words of activations
    localparam STATE_BITS = STATES > 1 ? $clog2(STATES) : 1;
    localparam HOLD = 8 * PORT * BEATS;
    localparam SECOND = CORES > 1 ? 1 : 0;  // core of the second output

    localparam [2:0] IDLE = 0, INPUTS = 1, LAYER = 2, DRAIN = 3, DECIDE = 4;
    localparam [2:0] FILL = 3;  // cycles from the last start to the pipeline's end

    reg [2:0] step;
    reg [2:0] left;  // cycles of DRAIN
    reg [7:0] layer;
    reg [15:0] slot;
    reg [15:0] word;

    // Facts of the layer at hand; the stage of inputs comes first in these tables.
    wire [7:0] stage = step == INPUTS ? 8'd0 : layer + 8'd1;
    wire [15:0] slots = SLOTS[16 * stage +: 16];
    wire [15:0] remainder = REMAINDERS[16 * stage +: 16];
    wire [15:0] words = WORDS[16 * layer +: 16];
    wire last_layer = layer == LAYERS - 1;
    wire last_slot = slot == slots - 16'd1;
    wire last_word = word == words - 16'd1;

    assign busy = step != IDLE;
    wire restart = step == IDLE && start;

    // ---- Refills: the cores that need a word get it before they start together. ----
    wire [CORES - 1:0] active;
    wire [CORES - 1:0] beyond;  // the next word is not in the core's memory
    wire [CORES - 1:0] needs = RESIDENT < WEIGHT_WORDS ? active & beyond : {CORES{1'b0}};
    wire stream = step == LAYER && needs != 0;
    wire go;  // products are started in this cycle
    reg [HOLD - 1:0] held [0:CORES - 1];
    reg [7:0] target;  // core that the port serves
    reg [7:0] beat;

    // Cores that need a word come before those that do not.
    wire served = beat == BEATS - 1 && (needs >> (target + 8'd1)) == 0;
    assign refill_ready = stream;
    assign go = step == LAYER && (!stream || (refill_valid && served));

    integer b;
    integer t;
    always @(posedge clk) begin
        if (reset || restart) begin
            target <= 0;
            beat <= 0;
        end else if (stream && refill_valid) begin
            for (t = 0; t < CORES; t = t + 1) begin
                for (b = 0; b < BEATS; b = b + 1) begin
                    if (target == t[7:0] && beat == b[7:0]) begin
                        held[t][8 * PORT * b +: 8 * PORT] <= refill_data;
                    end
                end
            end
            beat <= beat == BEATS - 1 ? 8'd0 : beat + 8'd1;
            if (served) target <= 0;
            else if (beat == BEATS - 1) target <= target + 8'd1;
        end
    end

    // ---- Sequencer. ----
    always @(posedge clk) begin
        if (reset) begin
            step <= IDLE;
            left <= 0;
            layer <= 0;
            slot <= 0;
            word <= 0;
        end else begin
            case (step)
                IDLE: begin
                    if (start) step <= INPUTS;
                    layer <= 0;
                    slot <= 0;
                    word <= 0;
                end
                INPUTS: begin
                    slot <= last_slot ? 16'd0 : slot + 16'd1;
                    if (last_slot) begin
                        step <= DRAIN;
                        left <= FILL - 3'd1;
                    end
                end
                LAYER: if (go) begin
                    word <= last_word ? 16'd0 : word + 16'd1;
                    if (last_word) begin
                        slot <= last_slot ? 16'd0 : slot + 16'd1;
                        if (last_slot) begin
                            step <= DRAIN;
                            // The adder follows, and but in the last layer the multiplier.
                            left <= last_layer ? FILL : FILL + 3'd1;
                        end
                    end
                end
                DRAIN: begin
                    left <= left - 3'd1;
                    if (left == 0) begin
                        step <= finished ? DECIDE : LAYER;
                        if (started) layer <= finished ? layer : layer + 8'd1;
                    end
                end
                default: step <= IDLE;  // DECIDE
            endcase
        end
    end

    reg started;  // a layer has begun: DRAIN is that of a layer, not of the inputs
    wire finished = started && last_layer;
    always @(posedge clk) begin
        if (reset || step == IDLE) started <= 1'b0;
        else if (step == LAYER) started <= 1'b1;
    end

    // ---- Results: up to CORES activations a cycle, to all cores, each to a lane of its own. ----
    wire [CORES - 1:0] result_valid;
    wire [7 * CORES - 1:0] results;
    reg [15:0] write_lane;  // of the first core's result
    reg [15:0] write_word;
    reg write_half;
    wire [15:0] next_lane = write_lane + CORES;
    wire begins = restart || (step == DRAIN && left == 0);

    always @(posedge clk) begin
        if (reset || begins) begin
            write_lane <= 0;
            write_word <= 0;
            write_half <= !(restart || reset) && !write_half;
        end else if (result_valid[0]) begin
            write_lane <= next_lane < MACS ? next_lane : next_lane - MACS;
            write_word <= next_lane < MACS ? write_word : write_word + 16'd1;
        end
    end

    reg [MACS - 1:0] lane_write;
    reg [MACS * (ADDRESS + 1) - 1:0] lane_address;
    reg [7 * MACS - 1:0] lane_value;
    integer c;
    integer lane;
    reg [15:0] place;
    reg [15:0] wrapped;
    reg [ADDRESS - 1:0] row;
    always @* begin
        lane_write = 0;
        lane_address = 0;
        lane_value = 0;
        place = 0;
        wrapped = 0;
        row = 0;
        for (c = 0; c < CORES; c = c + 1) begin
            place = write_lane + c[15:0];
            wrapped = place < MACS ? place : place - MACS;
            row = write_word[ADDRESS - 1:0] + (place < MACS ? 0 : 1);
            for (lane = 0; lane < MACS; lane = lane + 1) begin
                if (result_valid[c] && wrapped == lane[15:0]) begin
                    lane_write[lane] = 1'b1;
                    lane_address[(ADDRESS + 1) * lane +: ADDRESS + 1] = {write_half, row};
                    lane_value[7 * lane +: 7] = results[7 * c +: 7];
                end
            end
        end
    end

    // ---- State: its numbers go to the cores in turn. ----
    reg [7:0] state_core;
    reg [STATE_BITS - 1:0] state_slot;
    always @(posedge clk) begin
        if (reset || start) begin
            state_core <= 0;
            state_slot <= 0;
        end else if (state_write) begin
            state_core <= state_core == CORES - 1 ? 8'd0 : state_core + 8'd1;
            if (state_core == CORES - 1) state_slot <= state_slot + 1'b1;
        end
    end

    // ---- Cores. ----
    wire [CORES - 1:0] sum_valid;
    wire [32 * CORES - 1:0] sums;
    genvar g;
    generate
        for (g = 0; g < CORES; g = g + 1) begin : cores
            assign active[g] = !last_slot || g < remainder;
            exwarp_core #(
                .CORE(g), .MACS(MACS), .RESIDENT(RESIDENT), .WEIGHT_WORDS(WEIGHT_WORDS),
                .SCALES(SCALES), .BIASES(BIASES), .STATES(STATES), .STATE_BITS(STATE_BITS), .ADDRESS(ADDRESS)
            ) core (
                .clk(clk),
                .restart(restart || reset),
                .state_write(state_write && state_core == g),
                .state_slot(state_slot),
                .state_value(state_value),
                .input_start(step == INPUTS && active[g]),
                .input_slot(slot[STATE_BITS - 1:0]),
                .start(go && active[g]),
                .first(word == 0),
                .last(last_word),
                .hidden(!last_layer),
                .read_at({layer[0], word[ADDRESS - 1:0]}),
                .streamed(stream),
                .beyond(beyond[g]),
                .held(held[g][8 * MACS - 1:0]),
                .lane_write(lane_write),
                .lane_address(lane_address),
                .lane_value(lane_value),
                .result_valid(result_valid[g]),
                .result(results[7 * g +: 7]),
                .sum_valid(sum_valid[g]),
                .sum(sums[32 * g +: 32])
            );
        end
    endgenerate

    wire unused = &{1'b0, sums, sum_valid};  // of cores without an output

    // ---- Decision: the last layer's two sums, from two cores or one after the other from one. ----
    always @(posedge clk) begin
        if (reset) begin
            done <= 1'b0;
            choice <= 1'b0;
            output_warp <= 0;
            output_extrapolate <= 0;
        end else begin
            if (restart) done <= 1'b0;
            if (sum_valid[0]) begin
                output_warp <= CORES == 1 ? output_extrapolate : sums[31:0];
                if (CORES == 1) output_extrapolate <= sums[31:0];
            end
            if (CORES > 1 && sum_valid[SECOND]) output_extrapolate <= sums[32 * SECOND +: 32];
            if (step == DECIDE) begin
                choice <= output_extrapolate > output_warp;
                done <= 1'b1;
            end
        end
    end
endmodule

`default_nettype wire
